"""What the pictures of a result show, as arrays and words: all that it takes to draw them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

UNUSED = 0.55  # grey of samples that were not used
DIVERGING = "PuOr"  # readable with every common colour blindness
# the unfolded faces, of side 1: the upper halves of four side by side, and +z above +x, whose top edge it shares
PLACES = {"+y": 0, "+x": 1, "-y": 2, "-x": 3, "+z": 1}  # faces to the left of each
WIDTH, HEIGHT, SIDE_TOP = 4.0, 1.5, 0.5


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Samples that were left out for one reason.

    Attributes:
        samples: which, row 0 at the largest y.
        colour: that they are shown in, "#rrggbb".
        label: why, and how many.
    """

    samples: Bool[np.ndarray, "rows columns"]
    colour: str
    label: str


@dataclass(frozen=True, eq=False)
class FitContent:
    """An observed and a predicted receiver, and their difference; row 0 at the largest y.

    Attributes:
        shown: both as sRGB, grey where not used.
        difference: of the luminance, in 255ths of the brightest sample; NaN where not used.
        limit: of its scale.
        left_out: samples that the camera sees and that were not used, by reason.
        names: of the two.
        title: of the picture.
        units: of length.
        extent: of the receiver: left, right, bottom, top.
    """

    shown: tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns 3"]]
    difference: Float[np.ndarray, "rows columns"]
    limit: float
    left_out: tuple[LeftOut, ...]
    names: tuple[str, str]
    title: str
    units: str
    extent: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class ChannelFates:
    """The faces of one channel and the table below them.

    Attributes:
        title: of the faces.
        faces: the index of each texel's fate on the unfolded faces, NaN where no face is.
        borders: of the squares of constant light.
        head: of the table.
        rows: of the table.
    """

    title: str
    faces: Float[np.ndarray, "rows columns"]
    borders: Float[np.ndarray, "squares 5 2"]
    head: tuple[str, ...]
    rows: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, eq=False)
class FatesContent:
    """Which functions a light uses and why no others.

    Attributes:
        channels: from top to bottom.
        colours: of the fates, by index.
        legend: colour and name of those that occur.
    """

    channels: tuple[ChannelFates, ...]
    colours: tuple[str, ...]
    legend: tuple[tuple[str, str], ...]


Content = FitContent | FatesContent
