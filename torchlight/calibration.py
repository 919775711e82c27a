"""Intrinsics of a camera from photographs of a board.

Z. Zhang, "A flexible new technique for camera calibration", PAMI 2000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.camera import Lens
from torchlight.errors import CalibrationError
from torchlight.photo.boards import BoardView
from torchlight.photo.pose import locate, rigid

MIN_VIEWS = 3
MIN_TILT_SPREAD_DEGREES = 10.0
OUTLIER_RATIO = 3.0
OUTLIER_PIXELS = 0.5
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
DIAGONAL_OF_35MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True)
class Rejected:
    """A photograph that was left out, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera, and the evidence for it.

    Attributes:
        lens: K and the distortion k1 k2 p1 p2 k3.
        deviations: standard deviations of fx fy cx cy k1 k2 p1 p2 k3; NaN where there is no estimate.
        views: the photographs in use.
        poses: world to camera of each of them, the world being its board's.
        residuals: predicted minus seen of each of them, in pixels.
        rejected: photographs that were left out.
        rough: why the camera is only a starting point; empty where it is not.
    """

    lens: Lens
    deviations: Float[Tensor, "9"]
    views: tuple[BoardView, ...]
    poses: tuple[Float[Tensor, "4 4"], ...]
    residuals: tuple[Float[Tensor, "_ 2"], ...]
    rejected: tuple[Rejected, ...] = ()
    rough: str = ""

    @property
    def errors(self) -> list[float]:
        """RMS distance of predicted and seen corners of each photograph, in pixels."""
        return [each.square().sum(dim=-1).mean().sqrt().item() for each in self.residuals]

    @property
    def rms(self) -> float:
        """The same of all corners together."""
        return torch.cat(self.residuals).square().sum(dim=-1).mean().sqrt().item()


def calibrate(views: Sequence[BoardView]) -> Calibration:
    """Returns the camera under which the boards reproject best: least squares over K, k1 k2 p1 p2 k3 and all poses.

    Raises:
        CalibrationError: fewer than 3 photographs, of several sizes, or all looking at the board from one tilt.
    """
    check_views(views)
    points = [view.points.numpy().astype(np.float32).reshape(-1, 1, 3) for view in views]
    pixels = [view.pixels.numpy().astype(np.float32).reshape(-1, 1, 2) for view in views]
    size = views[0].image_size
    try:
        found = cv2.calibrateCameraExtended(points, pixels, size, np.eye(3), np.zeros(5))
    except cv2.error as error:
        raise CalibrationError(
            "calibration: the photographs determine no camera; tilt it by 30 degrees or more in several directions"
        ) from error
    _, matrix, distortion, turns, shifts, deviations, _, _ = found
    if not np.isfinite(matrix).all() or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise CalibrationError("calibration: no camera explains the photographs; check the board's counts and size")
    lens = Lens(torch.from_numpy(matrix), size, torch.from_numpy(distortion.reshape(-1)[:5].copy()))
    poses = [rigid(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
    check_tilts(poses)
    residuals = []
    for view, turn, shift in zip(views, turns, shifts, strict=True):
        shown, _ = cv2.projectPoints(view.points.numpy(), turn, shift, matrix, distortion)
        residuals.append(torch.from_numpy(shown.reshape(-1, 2)) - view.pixels)
    order = torch.from_numpy(deviations.ravel()[:9].copy())
    return Calibration(lens, order, tuple(views), tuple(poses), tuple(residuals))


def without_outliers(views: Sequence[BoardView]) -> Calibration:
    """Returns `calibrate` of the photographs that agree: the worst is left out while it is 3 times the median error.

    Errors below half a pixel are never a reason, and at least 3 photographs are kept.
    """
    kept, rejected = list(views), []
    while True:
        result = calibrate(kept)
        errors = result.errors
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        if errors[worst] <= max(OUTLIER_PIXELS, OUTLIER_RATIO * median) or len(kept) <= MIN_VIEWS:
            return replace(result, rejected=tuple(rejected))
        reason = f"its error of {errors[worst]:.2f} px is {errors[worst] / median:.1f} times the median {median:.2f} px"
        rejected.append(Rejected(kept.pop(worst).name, reason))


def check_views(views: Sequence[BoardView]) -> None:
    """Raises CalibrationError unless there are 3 photographs, all of one size."""
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"calibration: {len(views)} usable photograph{'s' if len(views) != 1 else ''} of the board, "
            f"at least {MIN_VIEWS} are needed, 10 to 20 are good"
        )
    check_sizes(views)


def check_sizes(views: Sequence[BoardView]) -> None:
    """Raises CalibrationError where photographs differ in size."""
    first = views[0]
    for view in views:
        if view.image_size != first.image_size:
            (width, height), (other_width, other_height) = first.image_size, view.image_size
            raise CalibrationError(
                f"calibration: {first.name} has {width} x {height} pixels but {view.name} {other_width} x "
                f"{other_height}; use photographs of one size, not cropped, not turned"
            )


def check_tilts(poses: Sequence[Float[Tensor, "4 4"]]) -> None:
    """Raises CalibrationError where all photographs look at the board from one tilt."""
    spread = tilt_spread_degrees(poses)
    if spread < MIN_TILT_SPREAD_DEGREES:
        raise CalibrationError(
            f"calibration: all {len(poses)} photographs look at the board from one tilt (within {spread:.1f} degrees), "
            "which leaves the focal length open; tilt the camera by 30 degrees or more in several directions"
        )


def tilt_spread_degrees(poses: Sequence[Float[Tensor, "4 4"]]) -> float:
    """Returns the largest angle between the boards' normals in camera axes.

    Views of parallel boards give the same two equations about K over and over (Zhang 2000, section 3.1).
    """
    normals = torch.stack(list(poses))[:, :3, 2]
    return math.degrees(math.acos((normals @ normals.T).clamp(-1, 1).min().item()))


def usual_lens(image_size: tuple[int, int], focal: float | None = None) -> Lens:
    """Returns a lens without distortion, centred, with a focal length in pixels: by default 1.2 times the long side."""
    width, height = image_size
    f = 1.2 * max(width, height) if focal is None else focal
    k = torch.tensor([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]], dtype=torch.float64)
    return Lens(k, image_size, torch.zeros(5, dtype=torch.float64))


def rough_start(view: BoardView, focal_35mm: float) -> Calibration:
    """Returns a starting point from one photograph: f = diagonal in pixels x (35 mm equivalent / 43.27 mm), no more.

    The equivalent is of the diagonal (CIPA DCG-001), rounded to a millimetre, before stabilisation and cropping; the
    middle of the picture and the distortion are assumed. Expect several percent.
    """
    focal = math.hypot(*view.image_size) * focal_35mm / DIAGONAL_OF_35MM
    lens = usual_lens(view.image_size, focal)
    pose = locate(view, lens)
    reason = (
        f"one photograph and an EXIF focal length of {focal_35mm:g} mm (35 mm equivalent): good to several percent, "
        "centre and distortion assumed; calibrate with 10 photographs or more before measuring"
    )
    nothing = torch.full((9,), math.nan, dtype=torch.float64)
    return Calibration(lens, nothing, (view,), (pose.world_to_camera,), (pose.residuals,), (), reason)
