"""Where the object stands, from its outline: pictures drawn from a convex hull, by no renderer of the package."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from scipy.spatial import ConvexHull
from sheet_photo import looking_at
from torch import Tensor
from torch.testing import assert_close
from workbench import BOX, CAMERA, LINEAR, RECEIVER, png, scene_file, torchlight

from torchlight.camera import Camera, pixel_directions, project
from torchlight.cli import spelled_out
from torchlight.errors import CalibrationError, ConfigError
from torchlight.geometry.contours import prepare
from torchlight.geometry.primitives import box, cylinder
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.geometry.visibility import scene_occlusion
from torchlight.photo.edges import BLUR, edges_across, slope_noise
from torchlight.photo.observation import linear_photo
from torchlight.placement import silhouette
from torchlight.placement.outline import outline, sensitivity
from torchlight.placement.report import Placement
from torchlight.shadow_fit import at, frame_of

K = torch.tensor([[500.0, 0, 162.3], [0, 503.0, 118.1], [0, 0, 1]], dtype=torch.float64)
LENS = torch.tensor([0.08, -0.21, 0.0011, -0.0007, 0.05], dtype=torch.float64)
CAMERA_THERE = Camera(K, looking_at((150.0, -180.0, 160.0), (0.0, 0.0, 10.0)), (320, 240), LENS)
PLANE = Receiver((0.0, 0.0), (160.0, 160.0), (16, 16))
BLOCK = transform(box((30.0, 20.0, 35.0)), 1.0, (0.0, 0.0, 30.0), (0.0, 0.0, 0.0))
STATED = Scene(BLOCK, PLANE, camera=CAMERA_THERE, units="mm", encoding="linear")
MOVED, TURNED = (2.0, -3.0), 2.0


def displaced(scene: Scene, x: float, y: float, degrees: float) -> Scene:
    frame = frame_of(scene)
    return at(frame, torch.tensor([x, y, math.radians(degrees)], dtype=torch.float64) / frame.unit)


def on_the_picture(scene: Scene, rows: Tensor, columns: Tensor) -> Tensor:
    """Returns the pixels' places on the pinhole's plane z = 1, in camera axes."""
    turn = CAMERA_THERE.world_to_camera[:3, :3]
    local = pixel_directions(CAMERA_THERE, torch.stack([columns, rows], dim=-1)) @ turn.T
    return local[..., :2] / local[..., 2:]


def hull(scene: Scene) -> Tensor:
    """Returns a n, c of the half-planes a . p + c <= 0 that a convex solid's pinhole picture consists of."""
    local = scene.triangles.reshape(-1, 3).double() @ CAMERA_THERE.world_to_camera[:3, :3].T
    local = local + CAMERA_THERE.world_to_camera[:3, 3]
    return torch.from_numpy(ConvexHull((local[:, :2] / local[:, 2:]).numpy()).equations)


@cache
def drawn(x: float, y: float, degrees: float, sub: int = 5) -> Tensor:
    """Returns a dark convex object on a bright ground: of each pixel the share that it covers, sub x sub points."""
    scene = displaced(STATED, x, y, degrees)
    sides = hull(scene)
    step = (torch.arange(sub, dtype=torch.float64) + 0.5) / sub - 0.5
    width, height = CAMERA_THERE.image_size
    rows, columns = torch.meshgrid(torch.arange(height).double(), torch.arange(width).double(), indexing="ij")
    covered = torch.zeros(height, width, dtype=torch.float64)
    for down in step:
        for right in step:
            places = on_the_picture(scene, rows + down, columns + right)
            covered += ((places @ sides[:, :2].T + sides[:, 2]) <= 0).all(dim=-1).double() / sub**2
    return (0.8 - 0.75 * covered).expand(3, -1, -1)


def noisy(picture: Tensor, deviation: float) -> Tensor:
    return picture + deviation * torch.randn(picture.shape, generator=torch.Generator().manual_seed(0))


# --- edges ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [40.0, 40.3, 40.77])
def test_a_step_blurred_by_a_pixel_is_found_where_it_is(place: float) -> None:
    """A column of light that ends at x = place, averaged over pixels, seen along x and at 30 degrees to it."""
    columns = torch.arange(80, dtype=torch.float64)
    grey = (place - (columns - 0.5)).clamp(0, 1).expand(60, -1)
    for angle in (0.0, 30.0):
        normal = torch.tensor([[math.cos(math.radians(angle)), math.sin(math.radians(angle))]], dtype=torch.float64)
        found = edges_across(grey, torch.tensor([[38.0, 30.0]], dtype=torch.float64), normal, 6.0, 0.0)
        assert int(found.slopes.count_nonzero()) == 1
        assert_close(found.offsets[0, 0].item(), (place - 38.0) / normal[0, 0].item(), rtol=0, atol=0.08)


def test_an_edge_below_the_noise_and_one_out_of_the_frame_are_none() -> None:
    step = torch.cat([torch.ones(60, 40), torch.full((60, 40), 0.97)], dim=1).double()
    grey = step + 0.02 * torch.randn(60, 80, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    places = torch.stack([torch.full((50,), 39.5), torch.linspace(8, 51, 50)], dim=1).double()
    normals = torch.tensor([1.0, 0.0], dtype=torch.float64).expand(50, 2)
    noise = slope_noise(grey, places, normals, 20.0)
    # the derivative of a Gaussian passes s / sqrt(4 sqrt(pi) BLUR^3) of white noise; reading bilinearly lowers it
    assert 0.6 < noise / (0.02 / math.sqrt(4 * math.sqrt(math.pi) * BLUR**3)) < 1.1
    assert edges_across(grey, places, normals, 3.0, noise).offsets.isnan().all()
    beyond = torch.tensor([[90.0, 30.0]], dtype=torch.float64)
    assert edges_across(step, beyond, normals[:1], 3.0, 0.0).offsets.isnan().all()


# --- the outline ----------------------------------------------------------------------------------------------------


def test_a_boxs_outline_is_the_hull_of_its_corners() -> None:
    test = scene_occlusion(STATED)
    seen = outline(prepare(BLOCK, 1e-6), CAMERA_THERE, test)
    assert bool(seen.framed.all())
    sides = hull(STATED)
    depth = (on_the_picture(STATED, seen.pixels[:, 1], seen.pixels[:, 0]) @ sides[:, :2].T + sides[:, 2]).amax(dim=-1)
    assert_close(500 * depth, torch.zeros_like(depth), rtol=0, atol=1e-6)  # on the rim, to a millionth of a pixel
    outwards = seen.pixels + seen.normals
    away = (on_the_picture(STATED, outwards[:, 1], outwards[:, 0]) @ sides[:, :2].T + sides[:, 2]).amax(dim=-1)
    assert bool((500 * away > 0.9).all())
    corners = project(CAMERA_THERE, BLOCK.reshape(-1, 3))
    nearest = (corners[:, None] - seen.pixels).norm(dim=-1).amin(dim=1)
    assert int((nearest < 4).reshape(-1).sum()) >= 6  # all six corners of the hull are reached


def test_its_movement_is_the_difference_of_displaced_outlines() -> None:
    """Central differences of the projected points along the normal."""
    seen = outline(prepare(BLOCK, 1e-6), CAMERA_THERE, scene_occlusion(STATED))
    frame, unit = frame_of(STATED), torch.tensor([1.0, 1.0, 0.1], dtype=torch.float64)
    rates = sensitivity(seen, CAMERA_THERE, frame.middle, unit)
    m, h = torch.cat([frame.middle, torch.zeros(1).double()]), 1e-5
    for index in range(3):
        ends = []
        for sign in (1, -1):
            step = sign * h * unit * torch.eye(3, dtype=torch.float64)[index]
            c, s = step[2].cos().item(), step[2].sin().item()
            turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1.0]], dtype=torch.float64)
            shift = torch.cat([step[:2], torch.zeros(1).double()])
            ends.append(project(CAMERA_THERE, (seen.points - m) @ turn.T + m + shift))
        expected = (seen.normals * (ends[0] - ends[1])).sum(dim=-1) / (2 * h)
        assert_close(rates[:, index], expected, rtol=1e-6, atol=1e-7)


# --- the pose -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_displaced_block_is_found_within_its_deviations(noise: float) -> None:
    scene, found = silhouette.refine(STATED, linear_photo(noisy(drawn(*MOVED, TURNED), noise)))
    x, y, turn = found.deviation
    assert x is not None
    assert y is not None
    assert turn is not None
    for value, true, spread in (
        (found.moved[0], MOVED[0], x),
        (found.moved[1], MOVED[1], y),
        (found.turned_degrees, TURNED, turn),
    ):
        assert abs(value - true) < 3 * spread
        assert spread < 0.2
    true = displaced(STATED, *MOVED, TURNED).triangles
    assert (scene.triangles - true).abs().max() < 0.1
    assert found.rms_after is not None
    assert found.rms_after < 0.3
    assert found.verdict.startswith("moved")


def test_a_block_in_its_place_is_left_there() -> None:
    scene, found = silhouette.refine(STATED, linear_photo(noisy(drawn(0.0, 0.0, 0.0), 0.02)))
    assert scene is STATED
    assert not found.changed
    assert "no movement beyond 4 of its deviations" in found.verdict


def test_the_turn_of_a_round_object_is_not_told_and_not_changed() -> None:
    round_one = replace(STATED, triangles=cylinder(12.0, 35.0))
    sides = hull(displaced(round_one, 1.5, 1.0, 0.0))
    rows, columns = torch.meshgrid(torch.arange(240).double(), torch.arange(320).double(), indexing="ij")
    parts = [
        (on_the_picture(round_one, rows + a, columns + b) @ sides[:, :2].T + sides[:, 2] <= 0).all(dim=-1).double()
        for a in (-0.375, -0.125, 0.125, 0.375)
        for b in (-0.375, -0.125, 0.125, 0.375)
    ]
    picture = 0.8 - 0.75 * sum(parts) / 16
    _, found = silhouette.refine(round_one, linear_photo(torch.as_tensor(picture).expand(3, -1, -1)))
    assert_close(found.moved, (1.5, 1.0), rtol=0, atol=0.1)
    assert found.deviation[2] is None
    assert abs(found.turned_degrees) < 0.5


def refused(photo: Tensor, scene: Scene = STATED) -> str:
    left, found = silhouette.refine(scene, linear_photo(photo))
    assert left is scene
    assert not found.changed
    assert found.verdict.startswith("left as stated: ")
    return found.verdict


def test_what_does_not_tell_leaves_the_object_and_says_why() -> None:
    even = torch.full((3, 240, 320), 0.5, dtype=torch.float64)
    assert "too few edges along its outline (0% of it" in refused(even)
    random = torch.rand(3, 240, 320, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    refused(random)
    refused(drawn(14.0, 0.0, 0.0))  # beyond the trusted distance
    away = displaced(STATED, 60.0, 60.0, 0.0)
    assert "of its outline lie in the frame" in refused(even, away)
    behind = replace(STATED, triangles=BLOCK + torch.tensor([300.0, -400.0, 0.0]))
    assert "only 0% of its outline lie in the frame" in refused(even, behind)


def test_without_a_camera_or_with_another_picture_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the scene has no camera"):
        silhouette.refine(replace(STATED, camera=None), linear_photo(drawn(0.0, 0.0, 0.0)))
    with pytest.raises(CalibrationError, match=r"100 x 90 pixels but camera\.image_size says 320 x 240"):
        silhouette.refine(STATED, linear_photo(torch.ones(3, 90, 100)))
    photo = png(tmp_path / "photo.png", torch.full((3, 32, 32), 0.5))
    scene = scene_file(tmp_path, BOX + RECEIVER + LINEAR)
    ran = torchlight("estimate", scene, photo, "--out", tmp_path / "out", "--refine-pose", "silhouette")
    assert ran.code == 2
    assert "use --refine-pose shadow" in ran.line


# --- the command ----------------------------------------------------------------------------------------------------


def test_a_bare_refine_pose_means_the_shadow() -> None:
    words = ["estimate", "--refine-pose", "scene.yaml", "photo.png", "--refine-pose"]
    assert spelled_out(words) == ["estimate", "--refine-pose", "shadow", *words[2:], "shadow"]
    stated = ["estimate", "scene.yaml", "--refine-pose", "silhouette", "--refine-pose=shadow"]
    assert spelled_out(stated) == stated
    assert spelled_out(["render", "--refine-pose"]) == ["render", "--refine-pose"]


def test_the_command_uses_the_pose_that_it_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    placement = Placement("silhouette", (0.1, -0.2), 3.0, (0.01, 0.02, None), 2.0, 0.2, 3, "moved")

    def moved(scene: Scene, photo: object) -> tuple[Scene, Placement]:
        return displaced(scene, 0.1, -0.2, 3.0), placement

    monkeypatch.setattr(silhouette, "refine", moved)
    photo = png(tmp_path / "photo.png", torch.linspace(0.2, 0.8, 96).expand(3, 72, 96))
    scene = scene_file(tmp_path, BOX + RECEIVER + CAMERA + LINEAR)
    options = ("--no-cache", "--method", "texels", "--resolution", 4, "--skip-near-test", "--refine-pose", "silhouette")
    ran = torchlight("estimate", scene, photo, "--out", tmp_path / "out", *options)
    assert ran.code == 0, ran.err
    assert "the object was moved by (0.1, -0.2) mm" in ran.out
    assert "RMS 2.00 -> 0.20 pixels" in ran.out
    result = json.loads((tmp_path / "out" / "photo" / "result.json").read_text())
    assert result["placement"]["by"] == "silhouette"
