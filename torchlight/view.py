"""The scene as a picture: the rectified receiver, or the camera's view of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera, pixel_directions
from torchlight.geometry.footprints import shown_samples
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import OcclusionTest, scene_occlusion
from torchlight.light.environment import EnvironmentMap
from torchlight.relighting import relight

FINEST_SAMPLES = 384  # along the receiver's longer side, for a camera's view
PIXELS_PER_CALL = 500_000
FARTHEST = 1e3  # scene sizes: farther than any occluder
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class View:
    """A rendered picture.

    Attributes:
        values: v = albedo E / pi; 0 on occluders and beyond the receiver.
        shows_plane: True where a pixel shows the receiver.
        opaque: True where a pixel shows the receiver or an occluder.
    """

    values: Float[Tensor, "3 height width"]
    shows_plane: Bool[Tensor, "height width"]
    opaque: Bool[Tensor, "height width"]


def render(scene: Scene, light: EnvironmentMap, rays: int, progress: Progress | None = None) -> View:
    """Returns the camera's view of the scene under a light, or the rectified receiver where there is no camera."""
    return (
        rectified_view(scene, light, rays, progress)
        if scene.camera is None
        else camera_view(scene, scene.camera, light, rays, progress)
    )


def rectified_view(scene: Scene, light: EnvironmentMap, rays: int, progress: Progress | None = None) -> View:
    """Returns the receiver from straight above, one pixel per sample, row 0 at the largest y; occluders black."""
    columns, rows = scene.receiver.samples
    plane = standing_free(scene)
    values = relight(scene, light, rays, progress) * plane
    image = values.reshape(3, rows, columns).flip(1)
    return View(image, plane.reshape(rows, columns).flip(0), torch.ones(rows, columns, dtype=torch.bool))


def camera_view(
    scene: Scene, camera: Camera, light: EnvironmentMap, rays: int, progress: Progress | None = None
) -> View:
    """Returns what the camera sees: receiver values interpolated from a fine grid of samples, hidden pixels black.

    Samples on which an occluder stands take no part in the interpolation, so that its foot casts no dark rim.
    """
    fine = replace(scene, receiver=refined(scene.receiver), camera=None)
    free = standing_free(fine)
    values = relight(fine, light, rays, progress).float().cpu()
    samples = torch.cat([values * free, free.float()[None]])
    columns, rows = fine.receiver.samples
    grid = samples.reshape(1, 4, rows, columns)
    test = scene_occlusion(scene)
    width, height = camera.image_size
    picture = torch.zeros(3, height * width)
    plane, opaque = torch.zeros(height * width, dtype=torch.bool), torch.zeros(height * width, dtype=torch.bool)
    for start in range(0, height * width, PIXELS_PER_CALL):
        index = torch.arange(start, min(start + PIXELS_PER_CALL, height * width))
        pixels = torch.stack([index % width, index // width], dim=-1).double()
        directions = pixel_directions(camera, pixels)
        depth = plane_depth(camera, directions)
        hit = meets_occluder(test, camera, directions, depth)
        points = camera.position[:2] + depth[:, None] * directions[:, :2]
        on_plane = on_receiver(points, scene.receiver)
        values = interpolate(grid, points, scene.receiver)
        shown = on_plane & ~hit
        picture[:, index] = torch.where(shown, values, torch.zeros_like(values))
        plane[index], opaque[index] = shown, shown | hit
    return View(picture.reshape(3, height, width), plane.reshape(height, width), opaque.reshape(height, width))


def meets_occluder(
    test: OcclusionTest, camera: Camera, directions: Float[Tensor, "pixels 3"], depth: Float[Tensor, " pixels"]
) -> Bool[Tensor, " pixels"]:
    """Returns whether the camera sees an occluder in each direction; what is below the plane is hidden by it."""
    origin = test.frame.to_unit(camera.position.double().cpu().numpy()[None]).astype(np.float32)
    origins = np.ascontiguousarray(np.broadcast_to(origin, directions.shape))
    reach = depth.clamp(max=FARTHEST / test.frame.scale) * test.frame.scale
    rays = (directions * reach[:, None]).cpu().numpy().astype(np.float32)
    return torch.from_numpy(test.hits(origins, rays, 1.0))


def standing_free(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns the samples on no part of which an occluder stands."""
    return shown_samples(replace(scene, camera=None))


def refined(receiver: Receiver) -> Receiver:
    """Returns the receiver with its samples split until the longer side has `FINEST_SAMPLES`, or as it is if finer."""
    factor = max(1, FINEST_SAMPLES // max(receiver.samples))
    columns, rows = receiver.samples
    return replace(receiver, samples=(columns * factor, rows * factor))


def plane_depth(camera: Camera, directions: Float[Tensor, "pixels 3"]) -> Float[Tensor, " pixels"]:
    """Returns the distance along each ray to z = 0, infinity where the ray does not meet it."""
    height = camera.position.to(directions)[2]
    meets = directions[:, 2] * height < 0
    return torch.where(meets, -height / directions[:, 2], torch.inf)


def on_receiver(points: Float[Tensor, "pixels 2"], receiver: Receiver) -> Bool[Tensor, " pixels"]:
    """Returns whether plane points lie on the receiver; points at infinity do not."""
    half = torch.tensor(receiver.size, dtype=points.dtype) / 2
    return ((points - torch.tensor(receiver.center, dtype=points.dtype)).abs() <= half).all(dim=-1)


def interpolate(
    grid: Float[Tensor, "1 4 rows columns"], points: Float[Tensor, "pixels 2"], receiver: Receiver
) -> Float[Tensor, "3 pixels"]:
    """Returns the grid's first three layers at plane points, bilinear over the samples whose fourth layer is 1."""
    middle = torch.tensor(receiver.center, dtype=points.dtype)
    size = torch.tensor(receiver.size, dtype=points.dtype)
    unit = ((points - middle) / size * 2).nan_to_num().clamp(-2, 2).to(grid)
    values = torch.nn.functional.grid_sample(
        grid, unit[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )[0, :, 0]
    return values[:3] / values[3:].clamp(min=1e-6)
