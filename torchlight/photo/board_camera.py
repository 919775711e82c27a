"""The camera of a photograph from the printed sheet it shows."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchlight.camera import Camera, Lens, Sighting
from torchlight.errors import CalibrationError
from torchlight.photo.boards import detect, grey_picture
from torchlight.photo.pose import locate
from torchlight.photo.target import Sheet

LARGEST_RMS = 0.002  # of the photograph's diagonal: more is another sheet, a bent sheet or another camera


@dataclass(frozen=True, eq=False)
class BoardCamera:
    """A calibrated lens and the sheet in front of it; the pose is each photograph's own.

    Attributes:
        lens: intrinsics and distortion.
        sheet: where the markers lie; its world is the scene's.
        intrinsics_sha256: of the lens's file.
        board_sha256: of the sheet's.
    """

    lens: Lens
    sheet: Sheet
    intrinsics_sha256: str = ""
    board_sha256: str = ""

    def __call__(self, pixels: Float[Tensor, "3 height width"], is_linear: bool, name: str) -> Camera:
        """Returns the camera of one photograph, and logs how sure its pose is.

        Raises:
            CalibrationError: too few markers, another size than the lens's, or markers that do not fit.
        """
        view = detect(self.sheet, grey_picture(pixels, is_linear), name)
        pose = locate(view, self.lens)
        width, height = self.lens.image_size
        if pose.rms > LARGEST_RMS * (width**2 + height**2) ** 0.5:
            raise CalibrationError(
                f"{name}: the markers are {pose.rms:.1f} px away from where the sheet has them; check that the sheet "
                "lies flat, that it is the one of camera.board, and that camera.intrinsics is this camera's"
            )
        corners = int(pose.used.sum())
        sighting = Sighting(
            pose.rms, corners, len(view.points) // 4, pose.position_deviation, pose.turn_deviation_degrees,
            self.intrinsics_sha256, self.board_sha256,
        )  # fmt: skip
        logging.getLogger("torchlight").info(
            "%s: pose from %d corners of %d markers: rms %.2f px, standard deviations %.2f mm and %.3f degrees",
            name, corners, len(view.points) // 4, pose.rms, pose.position_deviation, pose.turn_deviation_degrees,
        )  # fmt: skip
        return replace(self.lens.at(pose.world_to_camera), sighting=sighting)
