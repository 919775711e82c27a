"""Where the new object stands: on the plane at a place, or where a pose says."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.transforms import rotation_matrix, transform

SINKING = 1e-5  # of the object's size: more than the rounding of a mesh that was meant to rest on the plane
UPRIGHT = {"x": (0.0, -90.0, 0.0), "y": (90.0, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}
IN_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "in": 25.4}


def stood(
    triangles: Float[Tensor, "faces 3 3"],
    position: tuple[float, float] = (0.0, 0.0),
    turn_degrees: float = 0.0,
    scale: float = 1.0,
    up: str = "z",
) -> Float[Tensor, "faces 3 3"]:
    """Returns an object that rests on the plane, scaled, set upright and turned, its bounding box centred at a place.

    Args:
        triangles: in the mesh's own axes.
        position: x and y, in the scene's unit.
        turn_degrees: about +z, counter-clockwise seen from above.
        scale: above 0.
        up: the mesh's axis that becomes +z: "x", "y" or "z".

    Raises:
        ConfigError: an unknown axis, or a scale that is not positive.
    """
    if up not in UPRIGHT:
        raise ConfigError(f"up: expected x, y or z, got '{up}'")
    if not 0.0 < scale < float("inf"):
        raise ConfigError(f"scale: expected a number above 0, got {scale:g}")
    turned = rotation_matrix((0.0, 0.0, turn_degrees)) @ rotation_matrix(UPRIGHT[up])
    placed = scale * triangles.double() @ turned.T
    low, high = placed.reshape(-1, 3).amin(dim=0), placed.reshape(-1, 3).amax(dim=0)
    (x, y), foot = position, torch.stack([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return transform(placed, 1.0, (0.0, 0.0, 0.0), (x - foot[0].item(), y - foot[1].item(), -foot[2].item()))


def unit_scale(mesh_units: str, scene_units: str) -> float:
    """Returns the factor from a mesh's unit to the scene's.

    Raises:
        ConfigError: a unit that is not known.
    """
    for what, unit in (("--units", mesh_units), ("the scene's units", scene_units)):
        if unit not in IN_MILLIMETRES:
            raise ConfigError(f"{what}: expected one of {', '.join(IN_MILLIMETRES)}, got '{unit}'; use --scale instead")
    return IN_MILLIMETRES[mesh_units] / IN_MILLIMETRES[scene_units]


def check_above(triangles: Float[Tensor, "faces 3 3"]) -> None:
    """Raises SceneError unless the object has faces, is finite, and no part of it lies below the plane."""
    if len(triangles) == 0:
        raise SceneError("the object has no faces; export it with faces, as triangles")
    corners = triangles.reshape(-1, 3)
    if not bool(corners.isfinite().all()):
        raise SceneError("the object: some vertices are NaN or infinite once placed; check its mesh, scale and pose")
    low, high = corners.amin(dim=0), corners.amax(dim=0)
    lowest, extent = low[2].item(), torch.linalg.vector_norm(high - low).item()
    if lowest < -SINKING * extent:
        raise SceneError(
            f"the object lies {-lowest:.4g} below the plane (its lowest point is at z = {lowest:.4g}); raise it by "
            f"{-lowest:.4g}, or give no pose: it then rests on the plane"
        )
