"""Pixels that the photograph shows half plane and half old object, and of which the new object hides one half.

Such a pixel holds P = s B_o + (1 - s) B_p, s the old object's share. What stays visible has another share s', and shows

    P' = P (s' B_o + (1 - s') B_p) / (s B_o + (1 - s) B_p).

B_o and B_p are the means of the pixels around that show the old object alone, and the plane alone. Without this a
bright line of plane would remain between an old object and a new one behind it.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

AROUND = 5  # pixels: the square from which what a surface shows is taken
BOUND = 10.0


def visible_part(
    photo: Float[Tensor, "3 height width"],
    before: Float[Tensor, "height width"],
    after: Float[Tensor, "height width"],
) -> Float[Tensor, "3 height width"]:
    """Returns P' / P; 1 where nothing was mixed, nothing changed, or no pixel around shows one of the two alone.

    Args:
        photo: P, linear.
        before: s; NaN where it is not known.
        after: s', likewise.
    """
    mixed = (before > 0) & (before < 1) & (after != before) & after.isfinite()
    old, old_there = _mean_around(photo, before == 1)
    plane, plane_there = _mean_around(photo, before == 0)
    s, t = before.nan_to_num(), after.nan_to_num()
    factor = (t * old + (1 - t) * plane) / (s * old + (1 - s) * plane).clamp(min=1e-12)
    return torch.where(mixed & old_there & plane_there, factor.clamp(1 / BOUND, BOUND), torch.ones_like(factor))


def _mean_around(photo: Float[Tensor, "3 height width"], where: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the mean of marked pixels in the square round each pixel, and whether there is any."""
    layers = torch.cat([torch.where(where, photo, torch.zeros_like(photo)), where.to(photo)[None]]).double()
    sums = torch.nn.functional.avg_pool2d(layers[None], AROUND, 1, AROUND // 2)[0]
    return sums[:3] / sums[3:].clamp(min=1e-12), sums[3] > 1e-6
