"""light.png: a light to look at, with what its photograph did not determine marked as such, and a legend."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.analysis.confidence import Confidence
from torchlight.analysis.observability import DETERMINED
from torchlight.preview import encode_png, to_srgb8

PERIOD, LINE = 12, 2  # of the hatching, in pixels of a map that is 1,024 wide
USUAL_WIDTH = 1024
LINE_GREY, LINE_SHARE = 150, 0.75  # seen on white and on black
GROUND, GROUND_LINE = (232, 232, 232), (176, 176, 176)  # where nothing was asked, and its hatching
LEGEND_ROWS, SWATCH = 34, (46, 18)
TEXT = (30, 30, 30)


def marked_light(
    radiance: Float[Tensor, "3 height width"], scale: float, confidence: Confidence, fill: str = "none"
) -> bytes:
    """Returns a PNG of a light at one exposure; what is not determined is hatched, what is not observed cross-hatched.

    Args:
        radiance: of the light, filled or not.
        scale: the factor from radiance to linear picture values.
        confidence: of the light.
        fill: what stands where nothing was determined.
    """
    picture = to_srgb8(radiance.detach().cpu().double() * scale)
    height = radiance.shape[-2]
    unseen = confidence.unseen_map(height).numpy()
    doubtful = confidence.observability_map(height).numpy() < DETERMINED
    if fill == "none":
        picture[unseen] = GROUND
    return encode_png(np.concatenate([hatched(picture, doubtful, unseen), legend(picture.shape[1], fill)]))


def hatched(picture: NDArray[np.uint8], doubtful: NDArray[np.bool_], unseen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Returns a picture with lines over what is doubtful, crossed lines over what is unseen."""
    rows, columns = np.indices(picture.shape[:2])
    size = max(1, picture.shape[1] // USUAL_WIDTH)
    rising = (rows + columns) // size % PERIOD < LINE
    falling = (rows - columns) // size % PERIOD < LINE
    lines = doubtful & ~unseen & rising
    shown = picture.astype(np.float32)
    shown[lines] += LINE_SHARE * (LINE_GREY - shown[lines])
    shown[unseen & (rising | falling)] = GROUND_LINE
    return shown.round().astype(np.uint8)


def legend(width: int, fill: str) -> NDArray[np.uint8]:
    """Returns a strip that says what the hatchings mean."""
    from PIL import Image, ImageDraw, ImageFont

    strip = Image.new("RGB", (width, LEGEND_ROWS), "white")
    draw = ImageDraw.Draw(strip)
    font = ImageFont.load_default(size=13)
    left = 8
    for name, sample in zip(names(fill), swatches(), strict=True):
        strip.paste(Image.fromarray(sample), (left, (LEGEND_ROWS - SWATCH[1]) // 2))
        draw.text((left + SWATCH[0] + 6, LEGEND_ROWS // 2), name, fill=TEXT, font=font, anchor="lm")
        left += SWATCH[0] + 22 + int(draw.textlength(name, font=font))
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
