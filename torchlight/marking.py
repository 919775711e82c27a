"""light.png: a light to look at, with what its photograph did not determine marked as such, and a legend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchlight.analysis.confidence import Confidence
from torchlight.analysis.observability import DETERMINED
from torchlight.preview import encode_png

PERIOD, LINE = 12, 2  # of the hatching, in pixels of a map that is 1,024 wide
USUAL_WIDTH = 1024
LINE_GREY, LINE_SHARE = 150, 0.75  # seen on white and on black
GROUND, GROUND_LINE = (232, 232, 232), (176, 176, 176)  # where nothing was asked, and its hatching
LEGEND_ROWS, SWATCH = 34, (46, 18)
TEXT = (30, 30, 30)


def marked_light(picture: NDArray[np.uint8], confidence: Confidence, fill: str = "none") -> bytes:
    """Returns a PNG of a light; what is not determined is hatched, what is not observed cross-hatched.

    Args:
        picture: of the light, filled or not, 8-bit sRGB; its pixels are overwritten.
        confidence: of the light.
        fill: what stands where nothing was determined.
    """
    height = picture.shape[0]
    unseen = confidence.unseen_map(height).numpy()
    doubtful = confidence.observability_map(height).numpy() < DETERMINED
    if fill == "none":
        picture[unseen] = GROUND
    return encode_png(np.concatenate([hatched(picture, doubtful, unseen), legend(picture.shape[1], fill)]))


def hatched(picture: NDArray[np.uint8], doubtful: NDArray[np.bool_], unseen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Returns a picture with lines over what is doubtful, crossed lines over what is unseen; it is overwritten."""
    rows, columns = (np.arange(size) for size in picture.shape[:2])
    size = max(1, picture.shape[1] // USUAL_WIDTH)
    rising, falling = (np.add.outer(rows, turn * columns) // size % PERIOD < LINE for turn in (1, -1))
    lines = doubtful & ~unseen & rising
    under = picture[lines].astype(np.float32)
    picture[lines] = (under + LINE_SHARE * (LINE_GREY - under)).round().astype(np.uint8)
    picture[unseen & (rising | falling)] = GROUND_LINE
    return picture


def legend(width: int, fill: str) -> NDArray[np.uint8]:
    """Returns a strip that says what the hatchings mean."""
    from PIL import Image, ImageDraw, ImageFont

    font, said = ImageFont.load_default(size=13), names(fill)
    beside = SWATCH[0] + 26 + int(font.getlength(said[0]))
    apart = beside + SWATCH[0] + 26 + font.getlength(said[1]) > width  # one below the other
    strip = Image.new("RGB", (width, LEGEND_ROWS * (2 if apart else 1)), "white")
    draw = ImageDraw.Draw(strip)
    for index, (name, sample) in enumerate(zip(said, swatches(), strict=True)):
        left, top = (8, LEGEND_ROWS * index) if apart else (8 + beside * index, 0)
        strip.paste(Image.fromarray(sample), (left, top + (LEGEND_ROWS - SWATCH[1]) // 2))
        draw.text((left + SWATCH[0] + 6, top + LEGEND_ROWS // 2), name, fill=TEXT, font=font, anchor="lm")
    return np.asarray(strip)


def names(fill: str) -> tuple[str, str]:
    """Returns what the two hatchings stand for."""
    filled = "" if fill == "none" else f", filled ({fill})"
    return f"less than {DETERMINED:.0%} of fine structure determined", f"not observed: below the plane{filled}"


def swatches() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Returns a sample of each hatching."""
    plain = np.full((SWATCH[1], SWATCH[0], 3), 60, dtype=np.uint8)
    ground = np.full_like(plain, GROUND[0])
    nothing = np.zeros(plain.shape[:2], dtype=bool)
    return hatched(plain, ~nothing, nothing), hatched(ground, nothing, ~nothing)
