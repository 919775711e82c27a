"""Which directions an occluder hides: V(x, omega) by Embree, with a plain torch ray caster as its twin.

Both answer the same question, `occluded(origins, directions)`, about rays that start on the receiver. The scene
is first moved and scaled to the unit box, because Embree works in float32, and every origin is lifted by
`LIFT` of the scene's size along +z: a ray that starts exactly on a surface hits it about half of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.embree import FAR, OCCLUDED, embree_scene, is_here_or_warns
from torchlight.geometry.receiver import receiver_corners
from torchlight.geometry.scene import Scene

LIFT = 2e-6
PAIRS_PER_CALL = 1_000_000  # rays x triangles at once in the torch twin, about 150 MB

RayTest = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class UnitFrame:
    """The similarity that takes a scene into the unit box: unit = (world - center) * scale."""

    center: tuple[float, float, float]
    scale: float

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """Returns world points in the unit frame, float64."""
        return (points - np.asarray(self.center)) * self.scale


@dataclass(frozen=True, eq=False)
class OcclusionTest:
    """The occluders of a scene, ready to be asked.

    Attributes:
        frame: the unit frame the occluders were moved into.
        hits: (origins o, directions d, reach), float32 [rays, 3] in that frame -> whether each ray o + t d meets an
            occluder at some 0 < t < reach.
    """

    frame: UnitFrame
    hits: RayTest

    def hidden(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Returns whether each ray meets an occluder at any distance, [rays]; world coordinates."""
        starts = self.frame.to_unit(origins)
        starts[:, 2] += LIFT
        return self.hits(starts.astype(np.float32), directions.astype(np.float32), np.inf)

    def hidden_from(self, viewpoint: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Returns whether an occluder stands between a viewpoint and each plane point, [points]; world coordinates.

        What lies beyond the viewpoint, such as a ceiling over the camera, hides nothing.
        """
        starts = self.frame.to_unit(points)
        starts[:, 2] += LIFT
        towards = self.frame.to_unit(viewpoint) - starts
        return self.hits(starts.astype(np.float32), towards.astype(np.float32), 1.0)

    def hidden_on_plane(self, points: np.ndarray, directions: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """Returns whether each point is hidden from each direction, [directions, points].

        Args:
            points: x, y, z of the receiver's samples, [points, 3].
            directions: unit vectors towards the light, [directions, 3].
            offsets: shift of all ray origins in x and y, one per direction, [directions, 2].
        """
        unit = self.frame.to_unit(points)
        shift = offsets * self.frame.scale
        origins = np.empty((len(directions), len(points), 3), dtype=np.float32)
        origins[..., 0] = unit[:, 0] + shift[:, :1]
        origins[..., 1] = unit[:, 1] + shift[:, 1:]
        origins[..., 2] = unit[:, 2] + LIFT
        towards = np.repeat(directions.astype(np.float32), len(points), axis=0)
        return self.hits(origins.reshape(-1, 3), towards, np.inf).reshape(len(directions), len(points))


def unit_frame(points: Float[Tensor, "points 3"]) -> UnitFrame:
    """Returns the frame in which the bounding box of the points is centred and has a largest side of 1."""
    low, high = points.amin(dim=0), points.amax(dim=0)
    extent = (high - low).max().item()
    middle = ((low + high) / 2).tolist()
    return UnitFrame((middle[0], middle[1], middle[2]), 1.0 / extent if extent > 0 else 1.0)


def scene_occlusion(scene: Scene) -> OcclusionTest:
    """Returns the occlusion test of a scene's occluders, framed together with its receiver."""
    return occlusion_test(scene.triangles, receiver_corners(scene.receiver))


def occlusion_test(triangles: Float[Tensor, "faces 3 3"], bounds: Float[Tensor, "points 3"]) -> OcclusionTest:
    """Returns the occlusion test of a triangle soup.

    Args:
        triangles: the occluders, in the scene's unit.
        bounds: further points that the unit frame must hold (the receiver's corners, the camera).
    """
    frame = unit_frame(torch.cat([triangles.reshape(-1, 3), bounds.to(triangles)]))
    if len(triangles) == 0:
        return OcclusionTest(frame, lambda origins, directions, reach: np.zeros(len(origins), dtype=bool))
    tested = embree if is_here_or_warns() else raycast
    return OcclusionTest(frame, tested(triangles, frame))


def embree(triangles: Float[Tensor, "faces 3 3"], frame: UnitFrame) -> RayTest:
    """Returns the ray test by Embree (float32, one thread per call, safe to call from several threads)."""
    scene = embree_scene(frame.to_unit(triangles.double().cpu().numpy()), "raycast")

    def hits(origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        return scene.run(origins, directions, min(reach, FAR), query="OCCLUDED") == OCCLUDED

    return hits


def raycast(triangles: Float[Tensor, "faces 3 3"], frame: UnitFrame) -> RayTest:
    """Returns the ray test by brute force in torch, float64 (Moller and Trumbore 1997)."""
    corners = torch.from_numpy(frame.to_unit(triangles.double().cpu().numpy()))

    def hits(origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        step = max(1, PAIRS_PER_CALL // len(corners))
        starts = torch.from_numpy(origins).double().split(step)
        towards = torch.from_numpy(directions).double().split(step)
        return torch.cat([hits_any(corners, o, d, reach) for o, d in zip(starts, towards, strict=True)]).numpy()

    return hits


def hits_any(
    corners: Float[Tensor, "faces 3 3"],
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    reach: float = float("inf"),
) -> Bool[Tensor, " rays"]:
    """Returns whether each ray meets at least one triangle before its end.

    The ray o + t d meets the triangle a + u e1 + v e2 where u, v >= 0, u + v <= 1 and 0 < t < reach; the unknowns
    follow from Cramer's rule with the determinant e1 . (d x e2).
    """
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    normal = torch.linalg.cross(directions[:, None], second[None].expand(len(origins), -1, -1), dim=-1)
    determinant = (normal * first).sum(dim=-1)
    safe = torch.where(determinant.abs() < 1e-300, torch.full_like(determinant, torch.nan), determinant)
    offset = origins[:, None] - corners[None, :, 0]
    u = (offset * normal).sum(dim=-1) / safe
    across = torch.linalg.cross(offset, first[None].expand_as(offset), dim=-1)
    v = (across * directions[:, None]).sum(dim=-1) / safe
    t = (across * second).sum(dim=-1) / safe
    return ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < reach)).any(dim=-1)
