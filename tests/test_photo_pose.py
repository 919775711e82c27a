"""Poses against known cameras, against OpenCV's own refinement, and their covariance against repeated noise."""

from __future__ import annotations

import math

import cv2
import pytest
import torch
from realdata import data_path
from sheet_photo import LENS, SHEET, looking_at, photograph
from torch import Tensor
from torch.testing import assert_close

from torchlight.camera import project
from torchlight.errors import CalibrationError
from torchlight.io.cameras import read_lens
from torchlight.io.images import read_photo
from torchlight.photo.boards import BoardView, Charuco, detect, grey_picture
from torchlight.photo.pose import locate, moved
from torchlight.photo.target import marker_corners

POINTS = marker_corners(SHEET).reshape(-1, 3)
TRUE = looking_at((300.0, -500.0, 700.0), (10.0, 5.0, 0.0), 25.0)


def seen(noise: float, seed: int = 0) -> BoardView:
    generator = torch.Generator().manual_seed(seed)
    pixels = project(LENS.at(TRUE), POINTS)
    pixels = pixels + noise * torch.randn(pixels.shape, generator=generator, dtype=torch.float64)
    return BoardView("photo", POINTS, pixels, LENS.image_size)


def turn_degrees(one: Tensor, other: Tensor) -> float:
    cosine = ((one[:3, :3] @ other[:3, :3].T).trace().item() - 1) / 2
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def test_exact_corners_give_the_exact_pose() -> None:
    pose = locate(seen(0.0), LENS)
    assert_close(pose.world_to_camera, TRUE, atol=1e-7, rtol=0)
    assert pose.rms < 1e-7
    assert bool(pose.used.all())


def test_the_refined_pose_is_opencvs() -> None:
    view = seen(0.3)
    pose = locate(view, LENS)
    k, distortion = LENS.intrinsics.numpy(), LENS.distortion.numpy()
    start = cv2.Rodrigues(TRUE[:3, :3].numpy())[0], TRUE[:3, 3:].numpy().copy()
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-14)
    turn, shift = cv2.solvePnPRefineLM(
        view.points.numpy(), view.pixels.numpy(), k, distortion, start[0], start[1], criteria
    )
    assert_close(pose.world_to_camera[:3, 3], torch.from_numpy(shift)[:, 0], atol=1e-4, rtol=0)
    assert_close(pose.world_to_camera[:3, :3], torch.from_numpy(cv2.Rodrigues(turn)[0]), atol=1e-7, rtol=0)


def test_the_covariance_is_that_of_repeated_noise() -> None:
    errors, predicted = [], []
    for seed in range(150):
        pose = locate(seen(0.2, seed), LENS)
        twist = pose.world_to_camera[:3, :3] @ TRUE[:3, :3].T
        small = torch.stack([twist[2, 1], twist[0, 2], twist[1, 0]])
        errors.append(torch.cat([small, pose.world_to_camera[:3, 3] - TRUE[:3, 3]]))
        predicted.append(pose.covariance.diagonal())
    found = torch.stack(errors).square().mean(0).sqrt()
    assert_close(torch.stack(predicted).mean(0).sqrt() / found, torch.ones(6).double(), atol=0.2, rtol=0)
    # 150 draws: standard error of a standard deviation is 6 %; 0.2 is more than three of them


def test_the_motion_is_a_turn_and_a_shift() -> None:
    quarter = torch.tensor([0.0, 0.0, math.pi / 2, 1.0, 2.0, 3.0], dtype=torch.float64)
    expected = [[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert_close(moved(torch.eye(4).double(), quarter), torch.tensor(expected, dtype=torch.float64))


def test_corners_that_lie_far_off_are_left_out() -> None:
    view = seen(0.1)
    view.pixels[7] += torch.tensor([12.0, -9.0])
    view.pixels[60] += torch.tensor([-5.0, 4.0])
    pose = locate(view, LENS)
    assert (~pose.used).nonzero().flatten().tolist() == [7, 60]
    assert_close(pose.world_to_camera[:3, 3], TRUE[:3, 3], atol=0.2, rtol=0)


@pytest.mark.parametrize(
    ("place", "roll"), [((0.0, -700.0, 714.0), 0.0), ((500.0, -500.0, 707.0), 20.0), ((0.0, 1.0, 1000.0), 75.0)]
)
def test_a_rendered_sheet_at_a_metre_is_located_to_a_third_of_a_millimetre(
    place: tuple[float, float, float], roll: float
) -> None:
    true = looking_at(place, (0.0, 0.0, 0.0), roll)
    pose = locate(detect(SHEET, photograph(LENS.at(true), seed=int(roll)), "photo"), LENS)
    assert (pose.world_to_camera[:3, 3] - true[:3, 3]).norm().item() < 0.3
    assert turn_degrees(pose.world_to_camera, true) < 0.2


def test_another_size_a_line_and_another_board_are_one_line_each() -> None:
    view = seen(0.1)
    other = BoardView("photo", view.points, view.pixels, (1200, 1600))
    with pytest.raises(CalibrationError, match=r"photo: 1200 x 1600 pixels, but the camera was calibrated at 1600 x"):
        locate(other, LENS)
    line = [0, 1, 4, 5, 8, 9]  # upper corners of the lowest row of markers
    with pytest.raises(CalibrationError, match="photo: the corners seen lie on a line"):
        locate(BoardView("photo", view.points[line], view.pixels[line], LENS.image_size), LENS)


def test_opencvs_charuco_photograph_reprojects_under_a_pixel() -> None:
    folder = data_path("calib", "opencv_charuco")
    lens = read_lens(folder / "tutorial_camera_charuco.yml")
    grey = grey_picture(read_photo(folder / "choriginal.jpg").pixels)
    view = detect(Charuco(5, 7, 40.0, 20.0, "DICT_6X6_250"), grey, "choriginal.jpg")
    pose = locate(view, lens)
    assert len(view.points) == 24
    assert pose.rms < 1
    assert pose.world_to_camera[2, 2].item() < 0  # z comes out of the table
