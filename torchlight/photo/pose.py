"""The pose of one photograph from the board it shows, with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Lens
from torchlight.errors import CalibrationError
from torchlight.photo.boards import BoardView

MAX_STEPS = 50
SMALLEST_STEP = 1e-12
OUTLIER_SIGMAS = 5.0
OUTLIER_PIXELS = 1.0  # nearer than this, a corner is never called wrong
MIN_CORNERS = 6


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the camera stood.

    Attributes:
        world_to_camera: rigid transform of the board's world to OpenCV camera axes.
        covariance: of a small turn about the camera's axes, in radians, and of the translation, in the board's unit:
            sigma^2 (J^T J)^-1 with sigma^2 = |r|^2 / (2 n - 6).
        residuals: predicted minus seen, in pixels, of all corners.
        used: corners that the fit is made of; the others lie far off.
    """

    world_to_camera: Float[Tensor, "4 4"]
    covariance: Float[Tensor, "6 6"]
    residuals: Float[Tensor, "corners 2"]
    used: Bool[Tensor, " corners"]

    @property
    def rms(self) -> float:
        """Root of the mean squared distance between predicted and seen corners, in pixels."""
        return self.residuals[self.used].square().sum(dim=-1).mean().sqrt().item()

    @property
    def turn_deviation_degrees(self) -> float:
        """Standard deviation of the orientation, all three axes together."""
        return math.degrees(self.covariance[:3, :3].trace().sqrt().item())

    @property
    def position_deviation(self) -> float:
        """Standard deviation of the place of the board's origin in camera axes, all three together."""
        return self.covariance[3:, 3:].trace().sqrt().item()


def locate(view: BoardView, lens: Lens) -> Pose:
    """Returns the pose that reprojects a board's corners best, in least squares over the pixels.

    Starts from both solutions of the planar problem (Collins and Bartoli, "Infinitesimal plane-based pose estimation",
    IJCV 2014), refines each by Gauss-Newton and keeps the better. Corners farther off than 5 standard deviations and
    a pixel are left out, once; the standard deviation is taken from the median.

    Raises:
        CalibrationError: another photograph size than the lens's, corners on a line, or corners that do not fit.
    """
    if view.image_size != lens.image_size:
        raise CalibrationError(
            f"{view.name}: {view.image_size[0]} x {view.image_size[1]} pixels, but the camera was calibrated at "
            f"{lens.image_size[0]} x {lens.image_size[1]}; use one size for all photographs"
        )
    everything = torch.ones(len(view.points), dtype=torch.bool)
    first = _best(view, lens, everything)
    sigma = first.residuals.square().sum(-1).sqrt().median().item() / 1.1774  # median of a Rayleigh distribution
    near = first.residuals.square().sum(-1).sqrt() <= max(OUTLIER_PIXELS, OUTLIER_SIGMAS * sigma)
    if int(near.sum()) < max(MIN_CORNERS, len(near) // 2):
        raise CalibrationError(
            f"{view.name}: {int((~near).sum())} of {len(near)} corners do not fit any pose; "
            "check that it is this board and that the camera file is this camera's"
        )
    return first if bool(near.all()) else _best(view, lens, near)


def _best(view: BoardView, lens: Lens, used: Bool[Tensor, " corners"]) -> Pose:
    starts = _planar_solutions(view, lens, used)
    return min((_refined(view, lens, used, start) for start in starts), key=lambda pose: pose.rms)


def _planar_solutions(view: BoardView, lens: Lens, used: Bool[Tensor, " corners"]) -> list[Float[Tensor, "4 4"]]:
    """Returns one or two poses of the plane, in closed form, the better first; CalibrationError where there is none."""
    points, pixels = view.points[used].numpy(), view.pixels[used].numpy()
    spread = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)
    if len(points) < 4 or spread[-1] < 1e-6 * spread[0]:
        raise CalibrationError(f"{view.name}: the corners seen lie on a line; show more of the board")
    matrix, distortion = lens.intrinsics.double().numpy(), lens.distortion.double().numpy()
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error as error:
        raise CalibrationError(f"{view.name}: no pose fits the corners seen; show more of the board") from error
    return [rigid(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]


def rigid(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Float[Tensor, "4 4"]:
    """Returns [R|t; 0 0 0 1] in float64."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = torch.from_numpy(np.asarray(rotation)), torch.from_numpy(np.asarray(translation))
    return pose


def _refined(view: BoardView, lens: Lens, used: Bool[Tensor, " corners"], start: Float[Tensor, "4 4"]) -> Pose:
    """Returns the minimum of the squared residuals near a start, by Gauss-Newton steps halved until they help."""
    points, pixels = view.points[used], view.pixels[used]
    pose, error = start, _residuals(start, points, pixels, lens)
    for _ in range(MAX_STEPS):
        jacobian = _jacobian(pose, points, lens)
        step = -torch.linalg.lstsq(jacobian, error[:, None]).solution[:, 0]
        pose, error, moved = _line_search(pose, step, error, points, pixels, lens)
        if moved <= SMALLEST_STEP:
            break
    jacobian = _jacobian(pose, points, lens)
    variance = error.square().sum() / max(1, len(error) - 6)
    covariance = variance * torch.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    residuals = _residuals(pose, view.points, view.pixels, lens).reshape(-1, 2)
    return Pose(pose, covariance, residuals, used)


def _line_search(
    pose: Tensor, step: Tensor, error: Tensor, points: Tensor, pixels: Tensor, lens: Lens
) -> tuple[Tensor, Tensor, float]:
    for _ in range(12):
        candidate = moved(pose, step)
        changed = _residuals(candidate, points, pixels, lens)
        if bool(changed.square().sum() < error.square().sum()):
            scale = torch.cat([torch.ones(3), candidate[:3, 3].norm().expand(3)]).double()
            return candidate, changed, (step / scale).norm().item()
        step = step / 2
    return pose, error, 0.0


def moved(pose: Float[Tensor, "4 4"], twist: Float[Tensor, "6"]) -> Float[Tensor, "4 4"]:
    """Returns the pose after a small motion: R' = exp([w]) R and t' = t + d for twist = (w, d)."""
    x, y, z = twist[:3].unbind()
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    upper = torch.cat([torch.linalg.matrix_exp(skew) @ pose[:3, :3], (pose[:3, 3] + twist[3:])[:, None]], dim=1)
    return torch.cat([upper, pose[3:]])


def _jacobian(pose: Tensor, points: Tensor, lens: Lens) -> Tensor:
    """Returns the derivative of the residuals by (w, d) of `moved`: a corner's pixel depends on its own place only."""
    turned = points @ pose[:3, :3].T
    local = (turned + pose[:3, 3]).requires_grad_()
    shown = _shown(local, lens)
    by_place = torch.stack([torch.autograd.grad(shown[:, k].sum(), local, retain_graph=True)[0] for k in (0, 1)], dim=1)
    by_turn = torch.linalg.cross(turned[:, None].expand_as(by_place), by_place)  # a . (w x p) = w . (p x a)
    return torch.cat([by_turn, by_place], dim=-1).reshape(-1, 6)


def _residuals(pose: Tensor, points: Tensor, pixels: Tensor, lens: Lens) -> Tensor:
    """Returns predicted minus seen, x and y in turn."""
    return (_shown(points @ pose[:3, :3].T + pose[:3, 3], lens) - pixels).reshape(-1)


def _shown(local: Tensor, lens: Lens) -> Tensor:
    """Returns the pixel of each point in camera axes."""
    from kornia.geometry.calibration import distort_points

    k = lens.intrinsics.to(local)
    ideal = (local / local[:, 2:]) @ k.T
    return distort_points(ideal[None, :, :2], k[None], lens.distortion.to(local)[None])[0]
