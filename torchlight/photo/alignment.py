"""Has the camera moved between two exposures of one view? Bitmaps, compared at every shift.

A picture is cut at one of its quantiles, which exposure does not change (G. Ward, "Fast, Robust Image Registration for
Compositing High Dynamic Range Photographs from Handheld Exposures", JGT 8(2), 2003; there the median). The share of
agreeing pixels at every shift comes from one Fourier transform.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

QUANTILES = (0.5, 0.75, 0.9, 0.97, 0.25, 0.1)
LOWEST, HIGHEST = 0.08, 0.92  # stored values between which a quantile says where something is
UNSURE = 0.016  # stored values this close to the cut may fall on either side: four codes of 255
FARTHEST = 64
LARGEST = 1024


def shift_between(
    first: Float[Tensor, "height width"], second: Float[Tensor, "height width"]
) -> tuple[int, int] | None:
    """Returns by how many pixels (x, y) the second picture shows the same thing further right and down.

    Exact to `step` pixels, which is 1 for pictures up to 1024 pixels and grows with their size; up to 64 steps.

    Args:
        first: stored values in [0, 1] of one channel.
        second: the same view at another exposure.

    Returns:
        None where no quantile of both pictures lies in the middle of the codes: nothing can be said.
    """
    step = -(-max(first.shape) // LARGEST)
    first, second = (reduced(picture, step) for picture in (first, second))
    cuts = [(torch.quantile(first, q).item(), torch.quantile(second, q).item()) for q in QUANTILES]
    told = [cut for cut in cuts if all(LOWEST < value < HIGHEST for value in cut)]
    if not told:
        return None
    maps = [bitmap(picture, cut) for picture, cut in zip((first, second), told[0], strict=True)]
    size = [side + 2 * FARTHEST for side in first.shape]
    spectra = [torch.fft.rfft2(field, s=size) for field in maps]
    agreement = torch.fft.irfft2(spectra[0].conj() * spectra[1], s=size)
    near = agreement.roll((FARTHEST, FARTHEST), dims=(0, 1))[: 2 * FARTHEST + 1, : 2 * FARTHEST + 1]
    row, column = divmod(int(near.argmax()), near.shape[1])
    return (column - FARTHEST) * step, (row - FARTHEST) * step


def bitmap(picture: Float[Tensor, "height width"], cut: float) -> Float[Tensor, "height width"]:
    """Returns +1 above the cut, -1 below it and 0 near it."""
    return torch.where((picture - cut).abs() > UNSURE, (picture - cut).sign(), torch.zeros_like(picture))


def reduced(picture: Float[Tensor, "height width"], step: int) -> Float[Tensor, "rows columns"]:
    """Returns the means of squares of `step` pixels; what does not fill a square is left out."""
    rows, columns = (side // step * step for side in picture.shape)
    return picture[:rows, :columns].reshape(rows // step, step, columns // step, step).mean(dim=(1, 3))
