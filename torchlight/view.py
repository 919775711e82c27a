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
    samples = torch.cat([relight(fine, light, rays, progress) * free, free.to(torch.float32)[None]])
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
        hit = meets_occluder(test, camera, directions)
        points, on_plane = plane_points(camera, directions, scene.receiver)
        values = interpolate(grid, points, scene.receiver)
        shown = on_plane & ~hit
        picture[:, index] = torch.where(shown, values, torch.zeros_like(values))
        plane[index], opaque[index] = shown, shown | hit
    return View(picture.reshape(3, height, width), plane.reshape(height, width), opaque.reshape(height, width))


def meets_occluder(
    test: OcclusionTest, camera: Camera, directions: Float[Tensor, "pixels 3"]
) -> Bool[Tensor, " pixels"]:
    """Returns whether the camera sees an occluder in each direction; the plane hides nothing that stands on it."""
    origin = test.frame.to_unit(camera.position.double().cpu().numpy()[None]).astype(np.float32)
    origins = np.ascontiguousarray(np.broadcast_to(origin, directions.shape))
    return torch.from_numpy(test.hits(origins, directions.cpu().numpy().astype(np.float32), np.inf))


def standing_free(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns the samples on no part of which an occluder stands."""
    return shown_samples(replace(scene, camera=None))


def refined(receiver: Receiver) -> Receiver:
    """Returns the receiver with its samples split until the longer side has `FINEST_SAMPLES`, or as it is if finer."""
    factor = max(1, FINEST_SAMPLES // max(receiver.samples))
    columns, rows = receiver.samples
    return replace(receiver, samples=(columns * factor, rows * factor))


def plane_points(
    camera: Camera, directions: Float[Tensor, "pixels 3"], receiver: Receiver
) -> tuple[Float[Tensor, "pixels 2"], Bool[Tensor, " pixels"]]:
    """Returns where each pixel's ray meets z = 0, and whether that lies in front of the camera and on the receiver."""
    position = camera.position.to(directions)
    downwards = directions[:, 2] * position[2] < 0
    depth = torch.where(downwards, -position[2] / directions[:, 2], torch.zeros_like(directions[:, 2]))
    points = position[:2] + depth[:, None] * directions[:, :2]
    half = torch.tensor(receiver.size, dtype=points.dtype) / 2
    inside = ((points - torch.tensor(receiver.center, dtype=points.dtype)).abs() <= half).all(dim=-1)
    return points, downwards & inside


def interpolate(
    grid: Float[Tensor, "1 4 rows columns"], points: Float[Tensor, "pixels 2"], receiver: Receiver
) -> Float[Tensor, "3 pixels"]:
    """Returns the grid's first three layers at plane points, bilinear over the samples whose fourth layer is 1."""
    middle = torch.tensor(receiver.center, dtype=points.dtype)
    size = torch.tensor(receiver.size, dtype=points.dtype)
    unit = ((points - middle) / size * 2).to(grid)
    values = torch.nn.functional.grid_sample(
        grid, unit[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )[0, :, 0]
    return values[:3] / values[3:].clamp(min=1e-6)
