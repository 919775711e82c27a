"""A calibrated pinhole camera with lens distortion, in OpenCV's conventions.

x right, y down, z forward; world -> camera; pixel centres at integer coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import CalibrationError

DISTORTION_LENGTHS = (4, 5, 8, 12, 14)


@dataclass(frozen=True)
class Sighting:
    """How sure a pose is that was found from the board in a photograph.

    Attributes:
        rms_pixels: of the predicted minus the seen corners.
        corners: that the pose is made of.
        markers: that are seen.
        position_deviation: standard deviation of the board's origin in camera axes, in the board's unit.
        turn_deviation_degrees: standard deviation of the orientation.
        intrinsics_sha256: of the file that K and the distortion come from; empty where there is none.
        board_sha256: of the file that says where the markers lie; likewise.
    """

    rms_pixels: float
    corners: int
    markers: int
    position_deviation: float
    turn_deviation_degrees: float
    intrinsics_sha256: str = ""
    board_sha256: str = ""


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics, distortion and pose of one photograph.

    Attributes:
        intrinsics: K, in pixels.
        world_to_camera: rigid transform [R|t; 0 0 0 1] of column vectors, translation in the scene's unit.
        image_size: width and height in pixels.
        distortion: OpenCV order k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]; zeros = none.
        sighting: how sure the pose is, where it was found from a board; else None.
    """

    intrinsics: Float[Tensor, "3 3"]
    world_to_camera: Float[Tensor, "4 4"]
    image_size: tuple[int, int]
    distortion: Float[Tensor, " parameters"]
    sighting: Sighting | None = None

    def __post_init__(self) -> None:
        check_intrinsics(self.intrinsics)
        check_pose(self.world_to_camera)
        if self.distortion.shape[0] not in DISTORTION_LENGTHS or not bool(torch.isfinite(self.distortion).all()):
            raise CalibrationError(
                f"camera.distortion: expected {', '.join(map(str, DISTORTION_LENGTHS))} finite values "
                f"in OpenCV's order, got {self.distortion.tolist()}"
            )

    @property
    def position(self) -> Float[Tensor, "3"]:
        """Centre of projection in the world."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]


@dataclass(frozen=True, eq=False)
class Lens:
    """What a calibration finds and every photograph of one camera shares: a camera without its pose.

    Attributes:
        intrinsics: K, in pixels.
        image_size: width and height in pixels.
        distortion: OpenCV order, as in `Camera`.
    """

    intrinsics: Float[Tensor, "3 3"]
    image_size: tuple[int, int]
    distortion: Float[Tensor, " parameters"]

    def __post_init__(self) -> None:
        self.at(torch.eye(4, dtype=torch.float64))

    def at(self, world_to_camera: Float[Tensor, "4 4"]) -> Camera:
        """Returns the camera with this pose."""
        return Camera(self.intrinsics, world_to_camera, self.image_size, self.distortion)


def check_intrinsics(intrinsics: Float[Tensor, "3 3"]) -> None:
    """Raises CalibrationError unless K is finite, without skew, and with positive focal lengths."""
    k = intrinsics
    if not bool(torch.isfinite(k).all()):
        raise CalibrationError(f"camera.K: not all entries are finite: {k.tolist()}")
    zeros = k[[0, 1, 2, 2], [1, 0, 0, 1]].abs().max().item()
    if zeros > 0 or abs(k[2, 2].item() - 1) > 1e-9 or min(k[0, 0].item(), k[1, 1].item()) <= 0:
        raise CalibrationError(
            f"camera.K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 and no skew, got {k.tolist()}"
        )


def check_pose(pose: Float[Tensor, "4 4"]) -> None:
    """Raises CalibrationError unless the pose is a rigid motion (orthonormal to 1e-4, determinant +1)."""
    if not bool(torch.isfinite(pose).all()):
        raise CalibrationError(f"camera.world_to_camera: not all entries are finite: {pose.tolist()}")
    rotation = pose[:3, :3]
    identity = torch.eye(3, dtype=pose.dtype, device=pose.device)
    off = (rotation @ rotation.T - identity).abs().max().item()
    bottom = (pose[3] - torch.tensor([0, 0, 0, 1], dtype=pose.dtype, device=pose.device)).abs().max().item()
    if off > 1e-4 or bottom > 1e-9 or torch.linalg.det(rotation).item() < 0:
        raise CalibrationError(
            f"camera.world_to_camera: not a rigid motion (rotation off orthonormal by {off:.1e}); "
            "expected a 4x4 [R|t] that maps world to OpenCV camera axes"
        )


def to_camera(camera: Camera, points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Returns world points in camera axes (x right, y down, z forward)."""
    pose = camera.world_to_camera.to(points)
    return points @ pose[:3, :3].T + pose[:3, 3]


def project(camera: Camera, points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Returns the distorted pixel of each world point; NaN where the point is not in front of the camera."""
    from kornia.geometry.calibration import distort_points

    local = to_camera(camera, points).reshape(-1, 3)
    depth = local[:, 2:]
    in_front = depth > 0
    normalized = local[:, :2] / torch.where(in_front, depth, torch.ones_like(depth))
    k = camera.intrinsics.to(points)
    ideal = torch.cat([normalized, torch.ones_like(depth)], dim=-1) @ k.T
    pixels = distort_points(ideal[None, :, :2], k[None], camera.distortion.to(points)[None])[0]
    return torch.where(in_front, pixels, torch.full_like(pixels, torch.nan)).reshape(*points.shape[:-1], 2)


def pixel_directions(camera: Camera, pixels: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
    """Returns the unit world direction in which each (distorted) pixel looks, away from the camera."""
    from kornia.geometry.calibration import undistort_points

    k = camera.intrinsics.to(pixels)
    flat = pixels.reshape(1, -1, 2)
    ideal = undistort_points(flat, k[None], camera.distortion.to(pixels)[None], num_iters=30)[0]
    local = torch.cat([ideal, torch.ones_like(ideal[:, :1])], dim=-1) @ torch.linalg.inv(k).T
    world = local @ camera.world_to_camera.to(pixels)[:3, :3]
    return torch.nn.functional.normalize(world, dim=-1).reshape(*pixels.shape[:-1], 3)
