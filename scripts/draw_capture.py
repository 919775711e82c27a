"""Draws the pictures of docs/capture.md: the sheet, and the evidence of a calibration from rendered photographs."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from torchlight.calibration import without_outliers
from torchlight.photo.boards import detect
from torchlight.report.calibration_picture import calibration_picture

tests = import_module("sheet_photo")
IMAGES = Path(__file__).parents[1] / "docs" / "images"
PLACES = [
    (0, -350, 350), (300, -200, 400), (-300, -150, 380), (0, 20, 420), (200, 250, 350), (-220, 230, 300),
    (350, 0, 300), (-350, 50, 330),
]  # fmt: skip


def main() -> None:
    """Writes docs/images/target.png and docs/images/calibration.png."""
    views, pictures = [], []
    for k, (x, y, z) in enumerate(PLACES):
        aim = (18.0 * k - 63, 60.0 - 17 * k, 0.0)
        camera = tests.LENS.at(tests.looking_at((float(x), float(y), float(z)), aim, 40.0 * k))
        picture = tests.photograph(camera, seed=k)
        views.append(detect(tests.SHEET, picture, f"photo_{k + 1}.jpg"))
        pictures.append(picture)
    shown = cv2.resize(pictures[1], (800, 600), interpolation=cv2.INTER_AREA)
    page = tests.page()
    sheet = cv2.resize(page, None, fx=600 / len(page), fy=600 / len(page), interpolation=cv2.INTER_AREA)
    framed = cv2.copyMakeBorder(sheet[2:-2, 2:-2], 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(120,))
    gap = np.full((600, 24), 255, np.uint8)
    cv2.imwrite(str(IMAGES / "target.png"), np.hstack([framed, gap, shown]))
    (IMAGES / "calibration.png").write_bytes(calibration_picture(without_outliers(views)))


if __name__ == "__main__":
    main()
