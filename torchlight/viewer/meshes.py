"""What stands in the window: occluders, the dome that carries the light, and how things are turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.camera import Camera
from torchlight.geometry.scene import Scene

DOME_ROWS, DOME_COLUMNS = 24, 96


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: [vertices, 3], in the scene's unit.
        faces: [faces, 3], counter-clockwise seen from the side that shows.
        places: [vertices, 2], where in a texture: across from the left, up from the bottom; empty without one.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    places: NDArray[np.float32]


@dataclass(frozen=True)
class Frustum:
    """A camera as a pyramid.

    Attributes:
        fov_radians: vertical.
        aspect: width by height.
        wxyz: camera to world, x right, y down, z forward.
        position: of the centre of projection.
    """

    fov_radians: float
    aspect: float
    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]


def occluder_mesh(triangles: Float[Tensor, "faces 3 3"]) -> Mesh:
    """Returns the occluders with corners that coincide made one."""
    corners, places = torch.unique(triangles.reshape(-1, 3).float().cpu(), dim=0, return_inverse=True)
    return Mesh(corners.numpy(), places.reshape(-1, 3).int().numpy(), np.zeros((0, 2), dtype=np.float32))


def dome_mesh(radius: float, rows: int = DOME_ROWS, columns: int = DOME_COLUMNS) -> Mesh:
    """Returns the upper half of a sphere about the origin, seen from within, for the upper half of a lat-long map.

    Row and column of the map are theta and phi, as in `light.latlong`; the seam lies at -x.
    """
    theta = np.linspace(0, math.pi / 2, rows + 1)[:, None]
    phi = np.linspace(math.pi, -math.pi, columns + 1)
    directions = np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1
    )
    across, down = np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)[:, None]
    places = np.stack(np.broadcast_arrays(across, 1 - down), axis=-1)
    upper_left = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    quad = upper_left + np.array([0, columns + 1, columns + 2, 0, columns + 2, 1])
    return Mesh(
        (radius * directions).reshape(-1, 3).astype(np.float32),
        quad.reshape(-1, 3).astype(np.int32),
        places.reshape(-1, 2).astype(np.float32),
    )


def dome_radius(scene: Scene) -> float:
    """Returns a radius about the receiver's middle that holds receiver and occluders, with some room."""
    reach = math.hypot(*scene.receiver.size) / 2
    if len(scene.triangles):
        middle = torch.tensor([*scene.receiver.center, 0.0], dtype=torch.float64)
        corners = scene.triangles.reshape(-1, 3).double().cpu() - middle
        reach = max(reach, float(torch.linalg.vector_norm(corners, dim=-1).max()))
    return 1.25 * reach


def frustum(camera: Camera) -> Frustum:
    """Returns a camera's pyramid; lens distortion is left out."""
    width, height = camera.image_size
    turn = camera.world_to_camera[:3, :3].double().T
    x, y, z = camera.position.tolist()
    fov = 2 * math.atan(height / 2 / float(camera.intrinsics[1, 1]))
    return Frustum(fov, width / height, quaternion(turn), (x, y, z))


def quaternion(rotation: Float[Tensor, "3 3"]) -> tuple[float, float, float, float]:
    """Returns w, x, y, z of a rotation matrix; of q and -q the one with the largest entry positive.

    The four products 4 q q' on the diagonals and off them are linear in the matrix; the row of the largest is taken.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.double().tolist()
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    row = products[int(np.diag(products).argmax())]
    w, x, y, z = (row / np.linalg.norm(row)).tolist()
    return w, x, y, z


def about_z(degrees: float) -> tuple[float, float, float, float]:
    """Returns w, x, y, z of a turn about +z, counter-clockwise seen from above."""
    half = math.radians(degrees) / 2
    return math.cos(half), 0.0, 0.0, math.sin(half)
