"""Averages of the photograph over each sample's footprint: exact where that is possible, OpenCV where not."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.camera import Camera, project
from torchlight.geometry.footprints import footprint_points, subpoints_for
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.transforms import rotation_matrix
from torchlight.photo import rectification
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.photo.rectification import area_average, cell_overlap, from_camera, from_rectified


def random_photo(height: int, width: int, batch: tuple[int, ...] = ()) -> Tensor:
    generator = torch.Generator().manual_seed(height * width)
    return torch.rand(*batch, 3, height, width, generator=generator, dtype=torch.float64)


def everywhere(receiver: Receiver) -> Tensor:
    return torch.ones(receiver.points, dtype=torch.bool)


def looking_down(receiver: Receiver, pixels_per_unit: float) -> Camera:
    """A camera whose pixel (x, y) shows the plane at x / s + left, top - y / s: its rows run towards -y."""
    left, top = receiver.center[0] - receiver.size[0] / 2, receiver.center[1] + receiver.size[1] / 2
    pose = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    pose[2, 3] = 10.0
    focal = 10.0 * pixels_per_unit
    # a pixel's centre is an integer: its left edge, at the receiver's left edge, is -1/2
    intrinsics = torch.tensor(
        [[focal, 0, -left * pixels_per_unit - 0.5], [0, focal, top * pixels_per_unit - 0.5], [0, 0, 1]],
        dtype=torch.float64,
    )
    size = (round(receiver.size[0] * pixels_per_unit), round(receiver.size[1] * pixels_per_unit))
    return Camera(intrinsics, pose, size, torch.zeros(5, dtype=torch.float64))


def tilted() -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation_matrix((145.0, 6.0, 10.0))
    pose[:3, 3] = torch.tensor([0.0, 0.0, 6.0])
    intrinsics = torch.tensor([[700.0, 0, 320], [0, 690, 240], [0, 0, 1]], dtype=torch.float64)
    return Camera(intrinsics, pose, (640, 480), torch.zeros(5, dtype=torch.float64))


def photograph_of(camera: Camera, value: Tensor) -> Tensor:
    """What a camera without distortion shows of a plane of radiance a + b . (x, y), at pixel centres; value = a, b."""
    width, height = camera.image_size
    homography = camera.intrinsics @ camera.world_to_camera[:3, [0, 1, 3]]
    v, u = torch.meshgrid(torch.arange(height).double(), torch.arange(width).double(), indexing="ij")
    plane = torch.stack([u, v, torch.ones_like(u)], dim=-1) @ torch.linalg.inv(homography).T
    image = value[0] + plane[..., :2] / plane[..., 2:] @ value[1:]
    return image.expand(3, -1, -1)


# --- through a camera ----------------------------------------------------------------------------------------------


def test_a_camera_that_sees_one_pixel_per_sample_returns_the_pixels() -> None:
    """The identity homography, but for the rows: row 0 of a photograph is the largest y, row 0 of samples the least."""
    receiver = Receiver((0.5, -0.25), (12.0, 8.0), (12, 8))
    camera, photo = looking_down(receiver, 1.0), random_photo(8, 12)
    pixels = project(camera, footprint_points(receiver, 1))
    found = from_camera(linear_photo(photo), pixels, everywhere(receiver))
    assert_close(found.samples, photo.flip(1).flatten(start_dim=1), rtol=0, atol=1e-12)
    assert torch.equal(found.weights, torch.ones(96, dtype=torch.float64))


def test_a_ramp_seen_by_a_tilted_camera_has_its_value_at_every_sample_s_centre() -> None:
    """The mean of a linear function over a rectangle is its value at the centre."""
    receiver, camera = Receiver((0.1, 0.2), (3.0, 2.4), (20, 16)), tilted()
    value = torch.tensor([2.0, 0.3, -0.2], dtype=torch.float64)
    pixels = project(camera, footprint_points(receiver, subpoints_for(camera, receiver)))
    found = from_camera(linear_photo(photograph_of(camera, value)), pixels, everywhere(receiver))
    expected = (value[0] + sample_centers(receiver) @ value[1:]).expand(3, -1)
    # the photograph of a ramp is not quite linear in pixels: bilinear interpolation is off by its curvature
    assert_close(found.samples, expected, rtol=0, atol=2e-6)


def test_half_a_pixel_is_visible_in_a_ramp() -> None:
    """The tolerance of the ramp test tells pixel centres at integers from pixel centres at halves."""
    receiver, camera = Receiver((0.1, 0.2), (3.0, 2.4), (20, 16)), tilted()
    image = photograph_of(camera, torch.tensor([2.0, 0.3, -0.2], dtype=torch.float64))
    pixels = project(camera, footprint_points(receiver, 4))
    right, shifted = (from_camera(linear_photo(image), p, everywhere(receiver)).samples for p in (pixels, pixels + 0.5))
    assert (right - shifted).abs().min() > 1e-5


def test_a_distorted_photograph_agrees_with_opencv() -> None:
    """cv2.undistort + warpPerspective at 16 points per footprint edge, averaged, on a smooth picture."""
    receiver = Receiver((0.0, 0.0), (2.4, 2.0), (12, 10))
    plain = tilted()
    camera = Camera(
        plain.intrinsics,
        plain.world_to_camera,
        plain.image_size,
        torch.tensor([-0.1, 0.02, 0.001, -0.001, 0.0]).double(),
    )
    v, u = np.mgrid[0:480, 0:640]
    image = np.stack([np.sin(u / 37 + k) * np.cos(v / 29 - k) + 1.5 for k in range(3)], axis=-1).astype(np.float32)
    pixels = project(camera, footprint_points(receiver, 16))
    found = from_camera(linear_photo(torch.from_numpy(image).permute(2, 0, 1)), pixels, everywhere(receiver))
    ideal = cv2.undistort(image, camera.intrinsics.numpy(), camera.distortion.numpy())
    to_pixels = (camera.intrinsics @ camera.world_to_camera[:3, [0, 1, 3]]).numpy()
    # fine pixel (i, j) of the rectified image is the plane point low + (i + 1/2) step
    step, low = 0.2 / 16, (-1.2, -1.0)
    to_plane = np.array([[step, 0, low[0] + step / 2], [0, step, low[1] + step / 2], [0, 0, 1]])
    fine = cv2.warpPerspective(
        ideal, to_pixels @ to_plane, (12 * 16, 10 * 16), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    expected = fine.reshape(10, 16, 12, 16, 3).mean(axis=(1, 3)).reshape(-1, 3).T
    # two interpolations in place of one, and OpenCV's of 1/32 pixel
    assert_close(found.samples, torch.from_numpy(expected), rtol=0, atol=2e-3)
    assert found.samples.std() > 0.2


@pytest.mark.parametrize("spoiler", ["nan", "inf", "unusable"])
def test_a_spoiled_pixel_costs_exactly_the_samples_that_touch_it(spoiler: str) -> None:
    """Footprints of 4 x 4 pixels with points 1/2, 3/2, ... within: each depends on its own pixels alone."""
    receiver = Receiver((0.0, 0.0), (6.0, 5.0), (6, 5))
    camera, photo = looking_down(receiver, 4.0), random_photo(20, 24)
    pixels = project(camera, footprint_points(receiver, 4))
    clean = from_camera(linear_photo(photo), pixels, everywhere(receiver))
    usable = torch.ones(20, 24, dtype=torch.bool)
    usable[2, 9] = False  # sample column 9 // 4 = 2; row 2 // 4 = 0 from the top
    value = {"nan": math.nan, "inf": math.inf, "unusable": 7.0}[spoiler]
    spoiled_photo = torch.where(usable, photo, torch.full_like(photo, value))
    spoiled = LinearPhoto(spoiled_photo, usable) if spoiler == "unusable" else linear_photo(spoiled_photo)
    found = from_camera(spoiled, pixels, everywhere(receiver))
    expected = torch.ones(5, 6, dtype=torch.float64)
    expected[4, 2] = 0
    weights = found.weights.reshape(5, 6)
    neighbours = torch.zeros_like(expected, dtype=torch.bool)
    neighbours[3:5, 1:4] = True
    assert torch.equal(weights[~neighbours], expected[~neighbours])
    assert weights[4, 2] == 0
    # bilinear points within rounding of a pixel centre may touch the pixel next to it, never one farther away
    kept = found.weights > 0
    assert_close(found.samples[:, kept], clean.samples[:, kept], rtol=0, atol=1e-9)
    assert torch.equal(found.samples[:, ~kept], torch.zeros_like(found.samples[:, ~kept]))


def test_only_visible_samples_have_a_weight() -> None:
    receiver = Receiver((0.0, 0.0), (6.0, 5.0), (6, 5))
    visible = torch.arange(30) % 3 != 0
    pixels = project(looking_down(receiver, 4.0), footprint_points(receiver, 4))
    found = from_camera(linear_photo(random_photo(20, 24)), pixels, visible)
    assert torch.equal(found.weights, visible.double())
    rectified = from_rectified(linear_photo(random_photo(20, 24)), (6, 5), visible)
    assert torch.equal(rectified.weights, visible.double())
    assert_close(found.samples, rectified.samples, rtol=0, atol=1e-9)


def test_a_point_behind_the_camera_does_no_harm() -> None:
    pixels = torch.full((2, 4, 2), 3.0, dtype=torch.float64)
    pixels[1] = math.nan
    found = from_camera(linear_photo(random_photo(8, 8)), pixels, torch.tensor([True, False]))
    assert found.samples.isfinite().all()
    assert found.weights.tolist() == [1.0, 0.0]


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_batch_axes_and_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch, batch: tuple[int, ...]) -> None:
    receiver = Receiver((0.0, 0.0), (6.0, 5.0), (6, 5))
    pixels, visible = project(looking_down(receiver, 4.0), footprint_points(receiver, 3)), torch.arange(30) > 3
    photo = random_photo(20, 24, batch)
    found = [from_camera(linear_photo(photo), pixels, visible), from_rectified(linear_photo(photo), (6, 5), visible)]
    monkeypatch.setattr(rectification, "SUBPOINTS_PER_CALL", 9 * 7)
    flat = photo.reshape(-1, 3, 20, 24)
    for k, observation in enumerate(found):
        assert observation.samples.shape == (*batch, 3, 30)
        assert observation.weights.shape == (*batch, 30)
        for index, image in enumerate(flat):
            alone = (
                from_camera(linear_photo(image), pixels, visible)
                if k == 0
                else from_rectified(linear_photo(image), (6, 5), visible)
            )
            assert_close(observation.samples.reshape(-1, 3, 30)[index], alone.samples, rtol=0, atol=1e-13)
            assert torch.equal(observation.weights.reshape(-1, 30)[index], alone.weights)


# --- without one ---------------------------------------------------------------------------------------------------


def brute_average(image: Tensor, columns: int, rows: int) -> Tensor:
    """The mean over each rectangle, pixel by pixel from exact overlaps; row 0 is the bottom of the image."""
    height, width = image.shape
    result = torch.zeros(rows, columns, dtype=image.dtype)
    for row in range(rows):
        top, bottom = height * (rows - 1 - row) / rows, height * (rows - row) / rows
        for column in range(columns):
            left, right = width * column / columns, width * (column + 1) / columns
            total = 0.0
            for i in range(height):
                for j in range(width):
                    down = max(0.0, min(bottom, i + 1) - max(top, i))
                    across = max(0.0, min(right, j + 1) - max(left, j))
                    total += image[i, j].item() * down * across
            result[row, column] = total / ((bottom - top) * (right - left))
    return result


@pytest.mark.parametrize(
    ("height", "width", "rows", "columns"), [(7, 10, 3, 4), (4, 4, 4, 4), (3, 2, 5, 3), (9, 9, 3, 3)]
)
def test_area_averages_are_exact_for_any_ratio(height: int, width: int, rows: int, columns: int) -> None:
    image = random_photo(height, width)[0]
    found = area_average(image, (columns, rows))
    assert_close(found, brute_average(image, columns, rows))
    assert_close(found.mean(), image.mean())


def test_row_zero_is_the_largest_y() -> None:
    """The top row of the image lands on the last row of samples, which has the largest y."""
    image = torch.zeros(6, 8, dtype=torch.float64)
    image[:2] = 1.0
    found = area_average(image, (4, 3))
    assert_close(found, torch.tensor([[0.0], [0], [1]], dtype=torch.float64).expand(3, 4))
    y = sample_centers(Receiver((0.0, 0.0), (4.0, 3.0), (4, 3))).reshape(3, 4, 2)[..., 1]
    assert (y[2] > y[0]).all()


def test_shares_of_a_row_sum_to_one_and_do_not_leak_by_rounding() -> None:
    for cells, parts in ((22, 22), (22, 44), (10, 3), (640, 48), (999, 37), (5, 7), (49, 7), (1920, 128)):
        overlap = cell_overlap(cells, parts)
        assert_close(overlap.sum(dim=1), torch.ones(parts, dtype=torch.float64))
        assert_close(overlap.sum(dim=0), torch.full((cells,), parts / cells, dtype=torch.float64))
        touched = [
            math.ceil((p + 1) * cells / parts - 1e-9) - math.floor(p * cells / parts + 1e-9) for p in range(parts)
        ]
        assert (overlap > 0).sum(dim=1).tolist() == touched


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_spoiled_pixel_of_a_rectified_image_costs_the_samples_it_overlaps(value: float) -> None:
    photo = random_photo(7, 10)
    clean = from_rectified(linear_photo(photo), (4, 3), torch.ones(12, dtype=torch.bool))
    photo[1, 2, 2] = (
        value  # columns 2.0 to 3.0 of 10 meet 0..2.5 and 2.5..5; rows 2 to 3 of 7 meet 0..2.33 and 2.33..4.67
    )
    found = from_rectified(linear_photo(photo), (4, 3), torch.ones(12, dtype=torch.bool))
    expected = torch.ones(3, 4, dtype=torch.float64)
    expected[1:, :2] = 0
    assert torch.equal(found.weights.reshape(3, 4), expected)
    kept = found.weights > 0
    assert_close(found.samples[:, kept], clean.samples[:, kept])
    assert torch.equal(found.samples[:, ~kept], torch.zeros(3, 4, dtype=torch.float64))
