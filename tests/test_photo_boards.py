"""What detectors return: in the board's world, z up, and nothing where there is nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from sheet_photo import LENS, SHEET, looking_at, photograph
from torch.testing import assert_close

from torchlight.camera import Lens, project
from torchlight.errors import CalibrationError, ConfigError
from torchlight.photo.boards import Charuco, Chessboard, detect, grey_picture, marker_cells
from torchlight.photo.pose import locate
from torchlight.photo.target import make_sheet

CHESSBOARD = Chessboard(7, 5, 20.0)


def chessboard_picture() -> NDArray[np.uint8]:
    """Returns a chessboard of 40-pixel squares whose first inner corner lies between pixels 119 and 120."""
    row, column = np.mgrid[:6, :8]
    squares = np.kron((row + column) % 2 * 200 + 30, np.ones((40, 40)))
    return np.pad(squares, 80, constant_values=235).astype(np.uint8)


def charuco_picture(rows: int, legacy: bool) -> NDArray[np.uint8]:
    board = cv2.aruco.CharucoBoard((5, rows), 30.0, 20.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
    board.setLegacyPattern(legacy)
    return np.asarray(board.generateImage((5 * 90, rows * 90), marginSize=0), dtype=np.uint8)


def test_a_chessboard_from_above_has_x_to_the_right_y_up_and_z_towards_the_camera() -> None:
    view = detect(CHESSBOARD, chessboard_picture(), "board")
    assert view.image_size == (480, 400)
    expected = (view.pixels - 119.5) / 40 * 20  # row of the picture downwards
    if view.points[0, 0] == 0 and view.pixels[0, 0] > 200:  # a board of odd symmetry may be read from its other end
        expected = (view.pixels.flip(0) - 119.5) / 40 * 20
    assert_close(view.points[:, 0], expected[:, 0], atol=0.05, rtol=0)
    assert_close(view.points[:, 1], -expected[:, 1], atol=0.05, rtol=0)
    pose = locate(view, Lens(LENS.intrinsics, (480, 400), LENS.distortion)).world_to_camera
    assert pose[2, 2].item() < -0.99  # the world's z comes towards the camera


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("rows", [6, 7])
def test_charuco_boards_of_both_patterns_are_recognised(rows: int, legacy: bool) -> None:
    picture = np.pad(charuco_picture(rows, legacy), 60, constant_values=255)
    view = detect(Charuco(5, rows, 30.0, 20.0, "DICT_6X6_250"), picture, "board")
    assert len(view.points) == 4 * (rows - 1)
    assert_close(view.points[:, 0], (view.pixels[:, 0] - 59.5) / 3, atol=0.1, rtol=0)
    # rows are counted from the top of the board, downwards: y goes up
    assert_close(view.points[:, 1], -(view.pixels[:, 1] - 59.5) / 3, atol=0.1, rtol=0)


def test_markers_of_the_sheet_are_seen_where_the_camera_projects_them() -> None:
    camera = LENS.at(looking_at((200.0, -400.0, 500.0), (0.0, 0.0, 0.0), 15.0))
    view = detect(SHEET, photograph(camera), "photo")
    assert len(view.points) == 4 * len(SHEET.markers)
    distance = (view.pixels - project(camera, view.points)).norm(dim=-1)
    assert distance.square().mean().sqrt().item() < 0.1
    assert distance.max().item() < 0.3


def test_all_markers_are_read_at_a_slant_from_a_metre() -> None:
    for place in ((0.0, -700.0, 714.0), (500.0, -500.0, 707.0)):
        view = detect(SHEET, photograph(LENS.at(looking_at(place, (0.0, 0.0, 0.0), 15.0))), "photo")
        assert len(view.points) == 4 * len(SHEET.markers)


def test_any_four_markers_suffice_and_three_do_not() -> None:
    camera = LENS.at(looking_at((0.0, -300.0, 500.0), (0.0, 0.0, 0.0)))
    picture = photograph(camera)
    corners = detect(SHEET, picture, "photo").pixels.reshape(-1, 4, 2)
    for keep in (4, 3):
        covered = np.full_like(picture, 120)
        for quad in corners[:: len(corners) // keep][:keep].numpy():
            middle, reach = quad.mean(axis=0), int(np.abs(quad - quad.mean(axis=0)).max()) + 8
            x, y = int(middle[0]), int(middle[1])
            patch = np.s_[y - reach : y + reach, x - reach : x + reach]
            covered[patch] = picture[patch]
        if keep == 4:
            assert len(detect(SHEET, covered, "photo").points) == 16
        else:
            with pytest.raises(CalibrationError, match="photo: 3 markers of the sheet are seen, at least 4 are needed"):
                detect(SHEET, covered, "photo")


@pytest.mark.parametrize("board", [CHESSBOARD, Charuco(5, 7, 30.0, 20.0, "DICT_6X6_250"), make_sheet("A3")])
def test_no_board_is_one_line_that_names_the_photograph(board) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320)).astype(np.uint8)
    with pytest.raises(CalibrationError, match=r"empty.jpg: .*check") as caught:
        detect(board, noise, "empty.jpg")
    assert "\n" not in str(caught.value)


def test_marker_cells_are_opencvs_marker() -> None:
    cells = marker_cells("DICT_4X4_50", 7)
    source = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50).generateImageMarker(7, 60, borderBits=1)
    assert np.array_equal(np.kron(cells.numpy(), np.ones((10, 10))) > 0, source < 128)
    assert bool(cells[0].all() & cells[-1].all() & cells[:, 0].all() & cells[:, -1].all())


def test_grey_is_the_luma_of_encoded_values() -> None:
    pixels = torch.tensor([1.0, 0.5, 0.25])[:, None, None].expand(3, 2, 2)
    assert grey_picture(pixels)[0, 0] == round(255 * (0.299 + 0.587 * 0.5 + 0.114 * 0.25))
    linear = torch.full((3, 1, 1), 0.2140411)  # sRGB 0.5
    assert grey_picture(linear, is_linear=True)[0, 0] in (127, 128)


def test_what_is_no_board_is_refused() -> None:
    with pytest.raises(ConfigError, match="at least 3 x 3 inner corners"):
        Chessboard(2, 6, 20.0)
    with pytest.raises(ConfigError, match="0 < marker < square"):
        Charuco(5, 7, 20.0, 30.0, "DICT_6X6_250")
    with pytest.raises(ConfigError, match="OpenCV has no DICT_9X9"):
        Charuco(5, 7, 30.0, 20.0, "DICT_9X9")
    with pytest.raises(ConfigError, match="window"):
        Chessboard(7, 5, 20.0, 0)
