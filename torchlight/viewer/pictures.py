"""What is drawn on the plane and on the dome, as 8-bit pictures."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.drawing.content import DIVERGING, UNUSED
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap, luminance
from torchlight.preview import to_srgb8

RESIDUAL_LIMIT = 0.1  # of white: the ends of the colour map
MIN_SIDE = 256  # pixels: samples are drawn as squares of pixels, since a browser would blur few of them
Image = NDArray[np.uint8]


def plane_picture(
    values: Float[Tensor, "3 points"], used: Bool[Tensor, " points"] | None, receiver: Receiver, scale: float
) -> Image:
    """Returns samples as sRGB, row 0 at the largest y; those not used are grey.

    Args:
        values: linear.
        used: None = all.
        receiver: of the samples.
        scale: from values to white = 1.
    """
    columns, rows = receiver.samples
    image = to_srgb8((values * scale).reshape(3, rows, columns).flip(1))
    if used is not None:
        image[~used.reshape(rows, columns).flip(0).numpy(force=True)] = round(255 * UNUSED)
    return enlarged(image)


def residual_picture(
    predicted: Float[Tensor, "3 points"],
    observed: Float[Tensor, "3 points"],
    used: Bool[Tensor, " points"],
    receiver: Receiver,
    scale: float,
) -> Image:
    """Returns the luminance of predicted - observed: orange where too dark, violet where too bright; unused grey."""
    columns, rows = receiver.samples
    difference = luminance((predicted - observed) * scale).reshape(rows, columns).flip(0).numpy(force=True)
    image = mpl.colormaps[DIVERGING](0.5 + 0.5 * difference / RESIDUAL_LIMIT, bytes=True)[..., :3].copy()
    image[~used.reshape(rows, columns).flip(0).numpy(force=True)] = round(255 * UNUSED)
    return enlarged(image)


def dome_picture(environment: EnvironmentMap, scale: float) -> Image:
    """Returns the upper half of a map as sRGB; odd maps lose the row that the horizon cuts."""
    return to_srgb8(environment.radiance[:, : max(1, environment.height // 2)].double() * scale)


def enlarged(image: Image) -> Image:
    """Returns a small picture with every pixel repeated, so that none of its sides is below `MIN_SIDE`."""
    times = -(-MIN_SIDE // min(image.shape[:2]))
    return np.repeat(np.repeat(image, times, axis=0), times, axis=1)


def white_scale(values: Float[Tensor, "3 points"], used: Bool[Tensor, " points"]) -> float:
    """Returns the factor that makes the brightest used sample white; 1 where nothing is bright."""
    bright = torch.where(used, values, 0.0).max().item() if values.numel() else 0.0
    return 1 / bright if bright > 0 else 1.0
