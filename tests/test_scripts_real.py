"""What the scripts measure on real photographs, and the geometry they add: lamps at one height, half shadows, pages."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch
from realdata import data_path
from scipy.io import savemat
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, FormatError, SceneError
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.io.exr import write_exr
from torchlight.light.environment import EnvironmentMap
from torchlight.light.latlong import pixel_directions
from torchlight.photo.observation import Observation

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
chair, cube, drawing, lamp_plane, page, pencil, sheets = (
    import_module(f"real.{name}") for name in ("chair", "cube", "drawing", "lamp_plane", "page", "pencil", "sheets")
)
SIDE, HEIGHT, LAMPS = 20.0, 20.0, 120.0
RECEIVER = Receiver((0.0, -4.0), (60.0, 44.0), (60, 44))


# --- lamps at one height -------------------------------------------------------------------------------------------


def test_lamp_height_is_that_of_the_rays_through_an_edge() -> None:
    for lamp in (150.0, 400.0, 3000.0):
        shadow = 101.0 * lamp / (lamp - 104.0)
        assert_close(lamp_plane.lamp_height(101.0, shadow, 104.0), lamp, rtol=1e-9, atol=0)
    with pytest.raises(SceneError, match="not that of a near lamp"):
        lamp_plane.lamp_height(101.0, 101.0, 104.0)


def test_a_shadows_width_is_measured_between_its_half_bright_places() -> None:
    receiver = Receiver((0.0, 0.0), (200.0, 20.0), (200, 10))
    x = sample_centers(receiver)[:, 0].double()
    # penumbrae 8 wide about -61.3 and 58.9; the lit plane is brighter on the left
    left, right = ((x + 61.3) / -8 + 0.5).clamp(0, 1), ((x - 58.9) / 8 + 0.5).clamp(0, 1)
    samples = (0.02 + 0.5 * left + 0.3 * right).expand(3, -1).float()
    shown = Observation(samples, torch.ones(len(x)))
    width = lamp_plane.shadow_width(shown, sample_centers(receiver), (-5.0, 5.0), 40.0, 70.0)
    assert_close(width, 61.3 + 58.9, rtol=0, atol=1e-4)
    with pytest.raises(SceneError, match="edge is not in sight"):
        lamp_plane.shadow_width(
            replace(shown, samples=torch.ones(3, len(x))), sample_centers(receiver), (-5, 5), 40, 70
        )


# --- drawings ------------------------------------------------------------------------------------------------------


def a_drawing(shadow: list[list[float]]) -> object:
    axis = torch.tensor([[0.0, 0.0], [0.0, -20.0]], dtype=torch.float64)
    return drawing.Drawing(axis[0], axis[1], torch.tensor(shadow, dtype=torch.float64), ())


def test_right_of_the_axis_is_right_for_one_who_looks_at_the_object() -> None:
    # the axis runs towards -y, so the one who looks back along it looks towards +y and has +x at the right
    sides = drawing.right_of_axis(a_drawing([[0.0, 0.0]] * 3), torch.tensor([[1.0, 5.0], [-1.0, -5.0], [2.0, -30.0]]))
    assert sides.tolist() == [True, False, True]


def test_inside_a_polygon_that_is_not_convex() -> None:
    bracket = torch.tensor([[0.0, 0], [4, 0], [4, 4], [3, 4], [3, 1], [0, 1]], dtype=torch.float64)
    places = torch.tensor([[0.5, 0.5], [3.5, 3.5], [2.0, 2.0], [5.0, 0.5]], dtype=torch.float64)
    assert drawing.inside(bracket, places).tolist() == [True, True, False, False]


def test_a_drawing_without_its_axis_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("shadow_right: [[0, 0], [1, 0], [1, 1]]\nstick: []\n")
    with pytest.raises(ConfigError, match="expected axis"):
        drawing.read_drawing(tmp_path / "a.yaml")


def test_overlap() -> None:
    one, other = torch.tensor([True, True, True, False]), torch.tensor([False, True, True, True])
    assert cube.overlap(one, other) == 0.5


# --- half a shadow -------------------------------------------------------------------------------------------------


def tube_brightness(lamps: Tensor) -> Tensor:
    """Returns the share of the lamps that light each sample, by the slab test of every segment to one."""
    columns, rows = RECEIVER.samples
    fine = Receiver(RECEIVER.center, RECEIVER.size, (3 * columns, 3 * rows))
    points = torch.cat([sample_centers(fine).double(), torch.zeros(9 * columns * rows, 1)], dim=1)
    low, high = torch.tensor([-SIDE / 2, -SIDE / 2, 0.0]), torch.tensor([SIDE / 2, SIDE / 2, HEIGHT])
    lit = torch.zeros(len(points), dtype=torch.float64)
    for lamp in lamps:
        along = lamp - points
        along = torch.where(along == 0, 1e-12, along)
        ends = torch.stack([(low - points) / along, (high - points) / along])
        enter, leave = ends.amin(0).amax(-1).clamp(min=0), ends.amax(0).amin(-1).clamp(max=1)
        lit += (enter >= leave).double()
    return (lit / len(lamps)).reshape(rows, 3, columns, 3).mean(dim=(1, 3)).flatten()


def test_the_left_half_under_a_near_tube_predicts_the_right_half_at_its_height_alone(tmp_path: Path) -> None:
    # a tube along x above y = 40; by hand: the top edge's shadow runs at x = +-12 from y = -20 to 4
    lamps = torch.stack([torch.linspace(-5, 5, 21), torch.full((21,), 40.0), torch.full((21,), LAMPS)], 1).double()
    grey = 0.1 + 0.8 * tube_brightness(lamps)
    image = grey.reshape(RECEIVER.samples[::-1]).flip(0).float()
    write_exr(tmp_path / "photo.exr", image.expand(3, -1, -1), {})
    scene = Scene(torch.as_tensor(box((SIDE, SIDE, HEIGHT))).double(), RECEIVER, encoding="linear")
    right = a_drawing([[0.0, -20.0], [12.0, -20.0], [12.0, 4.0], [10.0, 10.0], [0.0, 10.0]])
    near = cube.half_shadow(tmp_path / "photo.exr", scene, right, LAMPS)
    assert cube.predicted_overlap(near) > 0.95
    assert near.estimate.observation.weights[near.right].max() == 0
    distant = cube.half_shadow(tmp_path / "photo.exr", scene, right)
    assert cube.predicted_overlap(distant) < 0.8


# --- the pencil ----------------------------------------------------------------------------------------------------


def test_angles() -> None:
    one, other = torch.tensor([[1.0, 0, 0], [math.cos(1e-6), math.sin(1e-6), 0]], dtype=torch.float64)
    assert_close(pencil.angle_degrees(one, other), math.degrees(1e-6), rtol=1e-9, atol=0)
    assert_close(pencil.angle_degrees(one, -one), 180.0)
    assert_close(pencil.between_azimuths(170.0, -175.0), 15.0)
    azimuth, elevation = pencil.azimuth_elevation(torch.tensor([-1.0, 1.0, math.sqrt(2)]))
    assert_close((azimuth, elevation), (135.0, 45.0), rtol=0, atol=1e-5)


def test_missing_photographs_of_the_pencil_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="pass --data"):
        next(pencil.pencils(tmp_path))


@pytest.mark.parametrize("number", range(1, 7))
def test_the_pencils_lamp_within_the_worst_that_is_allowed(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    data = data_path("photos", "desk_pencil").parents[1]
    monkeypatch.setattr(pencil, "PHOTOGRAPHS", range(number, number + 1))
    (found,) = pencil.pencils(data)
    assert found.off_degrees <= 4


# --- the chair -----------------------------------------------------------------------------------------------------


def test_a_file_that_is_no_workspace_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(b"no workspace at all")
    with pytest.raises(FormatError, match="test_image1"):
        chair.read_chair(tmp_path / "a.mat")
    with pytest.raises(FormatError, match="test_image1"):
        chair.read_chair(tmp_path / "none.mat")


def test_the_walls_top_right_lies_at_the_largest_x_and_y(tmp_path: Path) -> None:
    wall = np.zeros((126, 126, 3))
    wall[0, -1] = 1.0
    screen = np.zeros((29, 36, 3), dtype=np.uint8)
    savemat(tmp_path / "a.mat", {"test_image1": wall, "ground_truth1": screen})
    image, shown_on_screen = chair.read_chair(tmp_path / "a.mat")
    assert shown_on_screen.shape == (29, 36, 3)
    scene = cube.load_scene(chair.SCENE)
    shown = chair.observe(chair.linear_photo(image), scene)
    place = sample_centers(scene.receiver)[shown.samples[0].argmax()]
    assert place[0] > 940
    assert place[1] > 460


def test_the_screen_is_seen_where_its_light_comes_from() -> None:
    places = pixel_directions(256)
    x, y = chair.SCREEN * places[..., 0] / places[..., 2], chair.SCREEN * places[..., 1] / places[..., 2]
    # a bright quarter: small x, large height; its viewers have small x at the right
    quarter = (places[..., 2] > 0) & (x > 0) & (x < 228) & (y > 292) & (y < 500)
    picture = sheets.seen_screen(EnvironmentMap(quarter.float().expand(3, -1, -1)))[0]
    rows, columns = picture.shape
    assert picture[: rows // 2 - 8, columns // 2 + 8 :].min() > 0
    assert picture[rows // 2 + 8 :].max() == 0
    assert picture[:, : columns // 2 - 8].max() == 0


def test_the_chairs_wall_is_explained_by_light_on_the_screen_and_not_by_distant_light() -> None:
    data = data_path("photos", "periscopy_chair").parents[1]
    near, distant = chair.chair(data, chair.SCREEN), chair.chair(data)
    assert near.found.rms_255 < 0.25 * distant.found.rms_255
    # the strongest source lies on the screen, x 27 to 429 mm and z 139 to 445 mm
    x, y, z = near.found.peaks.directions[0].tolist()
    assert 27 < chair.SCREEN * x / z < 429
    assert 139 < chair.SCREEN * y / z < 445


# --- the cube ------------------------------------------------------------------------------------------------------


def test_the_cubes_lamp_is_as_high_in_two_photographs() -> None:
    data = data_path("photos", "desk_cube10cm").parents[1]
    height = cube.measured_lamp_height(data)
    scene = replace(cube.load_scene(cube.FOLDER / "img4.yaml"), reference="uniform")
    shown = cube.observe(cube.linearize(cube.read_photo(cube.photo_of(data, "img4")), scene), scene)
    width = lamp_plane.shadow_width(shown, sample_centers(scene.receiver), cube.ROWS, cube.CORE, cube.RIM)
    assert_close(lamp_plane.lamp_height(cube.SIDE, width, cube.HEIGHT), height, rtol=0.05, atol=0)


def test_the_left_of_the_cubes_shadow_predicts_its_right() -> None:
    data = data_path("photos", "desk_cube10cm").parents[1]
    half = cube.cube(data, cube.measured_lamp_height(data))
    assert cube.predicted_overlap(half) >= 0.85


# --- the page ------------------------------------------------------------------------------------------------------


def test_the_page_holds_its_pictures_and_says_what_is_not_met() -> None:
    rows = [page.Row("a < b", "1", "2", False), page.Row("c", "1", "1", True), page.Row("d", "-", "3", None)]
    assert [row.verdict for row in rows] == ["NO", "yes", "-"]
    text = page.page(rows, [page.Picture("one", "of & many", b"\x89PNG")])
    assert "a &lt; b" in text
    assert "of &amp; many" in text
    assert 'src="data:image/png;base64,iVBORw=="' in text
    assert page.table(rows).splitlines()[2] == "| a < b | 1 | 2 | NO |"
