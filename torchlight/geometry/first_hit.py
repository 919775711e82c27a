"""What a ray sees first: distance, face and place on the face, by Embree, with a plain torch twin.

As for occlusion (`visibility`), the triangles are moved and scaled to the unit box first: Embree works in float32.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.geometry.embree import FAR, embree_scene, is_here_or_warns
from torchlight.geometry.visibility import PAIRS_PER_CALL, UnitFrame, unit_frame

Nearest = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Hits:
    """The first triangle that each ray meets.

    Attributes:
        distance: along the unit direction, in the world's unit; infinite where the ray meets none.
        face: number of the triangle; -1 where there is none.
        corners: barycentric weights of its three corners; 0 where there is none.
    """

    distance: Float[Tensor, " rays"]
    face: Int[Tensor, " rays"]
    corners: Float[Tensor, "rays 3"]


@dataclass(frozen=True, eq=False)
class FirstHit:
    """Triangles, ready to be asked.

    Attributes:
        frame: the unit frame the triangles were moved into.
        nearest: (origins, directions), float32 [rays, 3] in that frame -> t, face (-1 = none), weights of the second
            and third corner [rays, 2].
    """

    frame: UnitFrame
    nearest: Nearest

    def seen(self, origins: Float[Tensor, "rays 3"], directions: Float[Tensor, "rays 3"]) -> Hits:
        """Returns the first hit of each ray, float64; world coordinates, unit directions."""
        starts = self.frame.to_unit(origins.double().cpu().numpy()).astype(np.float32)
        towards = np.ascontiguousarray(directions.cpu().numpy(), dtype=np.float32)
        t, face, second = self.nearest(starts, towards)
        there = face >= 0
        distance = np.where(there, t.astype(np.float64) / self.frame.scale, np.inf)
        later = np.where(there[:, None], second, 0.0).astype(np.float64)
        weights = np.concatenate([(there - later.sum(axis=1))[:, None], later], axis=1)
        return Hits(torch.from_numpy(distance), torch.from_numpy(face.astype(np.int64)), torch.from_numpy(weights))


def first_hit(triangles: Float[Tensor, "faces 3 3"], bounds: Float[Tensor, "points 3"]) -> FirstHit:
    """Returns the first-hit test of a triangle soup.

    Args:
        triangles: in the world's unit.
        bounds: further points that the unit frame must hold.
    """
    points = torch.cat([triangles.reshape(-1, 3), bounds.to(triangles)])
    if len(triangles) == 0:
        return FirstHit(unit_frame(points if len(points) > 0 else points.new_zeros(1, 3)), _nothing)
    frame = unit_frame(points)
    nearest = nearest_by_embree if is_here_or_warns() else nearest_by_torch
    return FirstHit(frame, nearest(triangles, frame))


def nearest_by_embree(triangles: Float[Tensor, "faces 3 3"], frame: UnitFrame) -> Nearest:
    """Returns the test by Embree (float32, one thread per call, safe to call from several threads)."""
    scene = embree_scene(frame.to_unit(triangles.double().cpu().numpy()), "nearest_by_torch")

    def nearest(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = scene.run(origins, directions, FAR, query="INTERSECT", output=True)
        return found["tfar"], found["primID"], np.stack([found["u"], found["v"]], axis=1)

    return nearest


def nearest_by_torch(triangles: Float[Tensor, "faces 3 3"], frame: UnitFrame) -> Nearest:
    """Returns the test by brute force in torch, float64 (Moller and Trumbore 1997)."""
    corners = torch.from_numpy(frame.to_unit(triangles.double().cpu().numpy()))

    def nearest(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        step = max(1, PAIRS_PER_CALL // len(corners))
        starts, towards = (torch.from_numpy(rays).double().split(step) for rays in (origins, directions))
        parts = [_nearest(corners, o, d) for o, d in zip(starts, towards, strict=True)]
        t, face, second = (torch.cat(values).numpy() for values in zip(*parts, strict=True))
        return t, face, second

    return nearest


def _nothing(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.full(len(origins), np.inf), np.full(len(origins), -1), np.zeros((len(origins), 2))


def _nearest(
    corners: Float[Tensor, "faces 3 3"], origins: Float[Tensor, "rays 3"], directions: Float[Tensor, "rays 3"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns t, face and the weights of the second and third corner; Cramer's rule as in `visibility.hits_any`."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = torch.linalg.cross(directions[:, None], second[None].expand(len(origins), -1, -1), dim=-1)
    determinant = (normal * first).sum(dim=-1)
    safe = torch.where(determinant.abs() < 1e-300, torch.full_like(determinant, torch.nan), determinant)
    offset = origins[:, None] - corners[None, :, 0]
    u = (offset * normal).sum(dim=-1) / safe
    across = torch.linalg.cross(offset, first[None].expand_as(offset), dim=-1)
    v = (across * directions[:, None]).sum(dim=-1) / safe
    t = (across * second).sum(dim=-1) / safe
    meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    t, face = torch.where(meets, t, torch.inf).min(dim=1)
    place = torch.stack([u, v], dim=-1)[torch.arange(len(origins)), face]
    return t, torch.where(t.isfinite(), face, -1), place
