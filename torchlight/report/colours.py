"""Colour maps as tables, as pictures and as style sheets; each readable with every common colour blindness.

The tables are Matplotlib's, which a page of HTML need not import: that takes a tenth of a second.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np
from numpy.typing import NDArray

from torchlight.drawing.content import DIVERGING, UNUSED

SEQUENTIAL = "cividis"
# of C. Brewer's PuOr in eleven colours, from orange to purple
PUOR = "7f3b08 b35806 e08214 fdb863 fee0b6 f7f7f7 d8daeb b2abd2 8073ac 542788 2d004b"
STOPS = 9
NOTHING = (round(255 * UNUSED),) * 3


@functools.cache
def table(name: str) -> NDArray[np.uint8]:
    """Returns the 256 colours of SEQUENTIAL or of DIVERGING."""
    levels = np.arange(256, dtype=np.uint8)
    if name == SEQUENTIAL:
        return np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_CIVIDIS)[:, 0, ::-1], dtype=np.uint8)
    given = np.array([tuple(bytes.fromhex(colour)) for colour in PUOR.split()])
    places = np.linspace(0, 255, len(given))
    return np.stack([np.interp(levels, places, part) for part in given.T], axis=1).round().astype(np.uint8)


def coloured(share: NDArray[np.floating], name: str, nothing: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Returns shares 0 to 1 as colours, grey where there is nothing to show."""
    index = (255 * np.clip(np.where(nothing, 0.0, share), 0, 1)).round().astype(np.uint8)
    picture = table(name)[index]
    picture[nothing] = NOTHING
    return picture


def rules() -> str:
    """Returns style rules for bars of the colour maps."""
    return "".join(f".bar.{name} {{ background: linear-gradient(to right, {stops(name)}); }}\n" for name in used())


def used() -> tuple[str, str]:
    """Returns the names of the maps that pages use."""
    return SEQUENTIAL, DIVERGING


def stops(name: str) -> str:
    """Returns evenly spaced colours of a map, as a gradient of a style sheet takes them."""
    chosen = table(name)[np.linspace(0, 255, STOPS).round().astype(int)]
    return ", ".join(f"#{r:02x}{g:02x}{b:02x}" for r, g, b in chosen.tolist())


def bar(name: str, ticks: tuple[str, ...]) -> str:
    """Returns a bar of a colour map with what its ends and middles stand for."""
    marks = "".join(f"<span>{tick}</span>" for tick in ticks)
    return f'<div class="bar {name}"></div><div class="ticks">{marks}</div>'
