"""The footprints of the receiver's samples, and which of them a photograph shows."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera, pixel_directions, project
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import LIFT, OcclusionTest, scene_occlusion

SUBPOINTS = 4  # along a footprint's edge, when asking whether all of it is seen
MAX_SUBPOINTS = 16
SKY_DIRECTIONS = 64
ASKED_TOGETHER = 4
POINTS_PER_CALL = 1_000_000
FOLD_COSINE = 1.0 - 1e-6  # a pixel must look back at the point it came from to within 0.08 degrees


def footprint_points(receiver: Receiver, subpoints: int) -> Float[Tensor, "points sub 3"]:
    """Returns subpoints x subpoints points of every sample's footprint, the centres of equal cells, on z = 0."""
    step = (torch.arange(subpoints, dtype=torch.float64) + 0.5) / subpoints - 0.5
    shift_y, shift_x = torch.meshgrid(step, step, indexing="ij")
    shift = torch.stack([shift_x, shift_y], dim=-1).reshape(1, -1, 2)
    size = torch.tensor(receiver.footprint, dtype=torch.float64)
    plane = sample_centers(receiver)[:, None] + shift * size
    return torch.cat([plane, torch.zeros_like(plane[..., :1])], dim=-1)


def subpoints_for(camera: Camera, receiver: Receiver) -> int:
    """Returns how many points along a footprint's edge lie at most one pixel apart in the photograph (at most 16)."""
    corners = footprint_points(receiver, 2)
    pixels = project(camera, corners).reshape(-1, 2, 2, 2)
    across = torch.linalg.vector_norm(pixels[:, :, 1] - pixels[:, :, 0], dim=-1)
    along = torch.linalg.vector_norm(pixels[:, 1] - pixels[:, 0], dim=-1)
    spans = torch.cat([across, along], dim=-1).nan_to_num(nan=0.0, posinf=0.0) * 2
    return int((spans.max() - 1e-6).ceil().clamp(1, MAX_SUBPOINTS).item())  # 4 pixels up to rounding: 4 points


def visible_samples(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns which samples may be used: those shown entirely, less a ring of one round the occluder and the frame."""
    return erode(shown_samples(scene), scene.receiver)


def shown_samples(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns which samples a photograph shows entirely.

    With a camera: every point of the footprint lies in the frame and no occluder stands between. Without one the
    photograph is a rectified receiver image, and only samples on which an occluder stands are left out.
    """
    test = scene_occlusion(scene)
    points = footprint_points(scene.receiver, SUBPOINTS)
    flat = points.reshape(-1, 3)
    seen = ~stands_on(scene, test, flat) if scene.camera is None else seen_by(scene.camera, test, flat)
    return seen.reshape(points.shape[:2]).all(dim=1)


def seen_by(camera: Camera, test: OcclusionTest, points: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
    """Returns whether each plane point is inside the frame and not hidden from the camera."""
    width, height = camera.image_size
    pixels = project(camera, points)
    inside = ((pixels >= 0) & (pixels <= torch.tensor([width - 1, height - 1]))).all(dim=-1)
    towards = torch.nn.functional.normalize(camera.position.to(points) - points, dim=-1)
    # far outside the field of view a distortion polynomial folds back into the frame: such points are not seen
    looks_back = (pixel_directions(camera, pixels.nan_to_num()) * towards).sum(dim=-1) < -FOLD_COSINE
    hidden = torch.from_numpy(test.hidden_from(camera.position.double().numpy(), points.numpy()))
    return inside & looks_back & ~hidden & (towards[:, 2] > 0)


def stands_on(scene: Scene, test: OcclusionTest, points: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
    """Returns whether an occluder stands on each plane point.

    That is: no light reaches the point from any of `SKY_DIRECTIONS` directions, and the surface winds round it (the
    signed number of faces above it is not 0), so that a plate or a lid that hovers over the plane does not count.
    """
    directions, dark = spiral_directions(SKY_DIRECTIONS), torch.arange(len(points))
    for start in range(0, SKY_DIRECTIONS, ASKED_TOGETHER):  # a point that one direction reaches is not asked again
        dark = dark[unlit(test, points[dark], directions[start : start + ASKED_TOGETHER])]
    under = winding_above(scene.triangles, points[dark][:, :2], LIFT / test.frame.scale) != 0
    result = torch.zeros(len(points), dtype=torch.bool)
    result[dark[under]] = True
    return result


def unlit(
    test: OcclusionTest, points: Float[Tensor, "points 3"], directions: Float[np.ndarray, "directions 3"]
) -> Bool[Tensor, " points"]:
    """Returns which plane points an occluder hides from every direction."""
    step = POINTS_PER_CALL // len(directions)
    still = np.zeros((len(directions), 2))
    parts = [test.hidden_on_plane(part.numpy(), directions, still).all(axis=0) for part in points.split(step)]
    return torch.from_numpy(np.concatenate(parts) if parts else np.zeros(0, dtype=bool))


def spiral_directions(count: int) -> np.ndarray:
    """Returns unit directions spread evenly over the upper hemisphere (a Fibonacci spiral), [count, 3]."""
    index = np.arange(count) + 0.5
    z = 1 - index / count
    phi = index * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1)


def winding_above(
    triangles: Float[Tensor, "faces 3 3"], xy: Float[Tensor, "points 2"], lift: float
) -> Float[Tensor, " points"]:
    """Returns, for each point of the plane, the signed count of faces straight above it (+1 seen from above).

    Faces less than `lift` above the plane lie in it: a turned solid rests on z = 0 only up to rounding.
    """
    winding = torch.zeros(len(xy), dtype=xy.dtype)
    above = triangles[triangles[:, :, 2].amax(dim=1) > lift].to(xy.dtype)
    step = max(1, POINTS_PER_CALL // max(1, len(above)))
    for start in range(0, len(xy), step):
        winding[start : start + step] = _signed_cover(above, xy[start : start + step], lift)
    return winding


def _signed_cover(
    faces: Float[Tensor, "faces 3 3"], xy: Float[Tensor, "points 2"], lift: float
) -> Float[Tensor, " points"]:
    sides = []
    for corner in range(3):
        start, end = faces[:, corner], faces[:, (corner + 1) % 3]
        edge = end - start
        offset = xy[:, None] - start[None, :, :2]
        sides.append(edge[None, :, 0] * offset[..., 1] - edge[None, :, 1] * offset[..., 0])
    side = torch.stack(sides)
    covers = (side > 0).all(dim=0).to(xy.dtype) - (side < 0).all(dim=0).to(xy.dtype)
    normal = torch.linalg.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    flat = torch.where(normal[:, 2] == 0, torch.ones_like(normal[:, 2]), normal[:, 2])
    tilt = torch.einsum("pfi,fi->pf", xy[:, None] - faces[None, :, 0, :2], normal[:, :2])
    height = faces[None, :, 0, 2] - tilt / flat
    return (covers * (height > lift)).sum(dim=1)


def erode(mask: Bool[Tensor, " points"], receiver: Receiver) -> Bool[Tensor, " points"]:
    """Returns the samples whose eight neighbours are all in the mask too; beyond the receiver nothing is missing."""
    columns, rows = receiver.samples
    missing = (~mask).float().reshape(1, 1, rows, columns)
    grown = torch.nn.functional.max_pool2d(missing, kernel_size=3, stride=1, padding=1)
    return (grown == 0).reshape(-1)
