"""Draws the pictures of docs/capture.md; no photograph is needed, all are drawn or rendered.

    python scripts/draw_capture.py

target.png: the sheet, and a rendered photograph of it. calibration.png: the evidence of a calibration from rendered
photographs. place.png: where to stand. objects.png: which object. avoid.png: what spoils a photograph.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
from capture.avoid import avoid_picture
from capture.objects import objects_picture
from capture.place import place_picture

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
    """Writes all five pictures to docs/images."""
    (IMAGES / "place.png").write_bytes(place_picture(tests.SHEET))
    (IMAGES / "objects.png").write_bytes(objects_picture())
    (IMAGES / "avoid.png").write_bytes(avoid_picture())
    draw_sheet_and_calibration()


def draw_sheet_and_calibration() -> None:
    """Writes target.png and calibration.png."""
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
