"""How noisy a photograph's samples are, from the photograph alone.

J. Immerkaer, "Fast Noise Variance Estimation", Computer Vision and Image Understanding 64(2), 1996: the mask

    N = [1 -2 1; -2 4 -2; 1 -2 1],   the second difference along x of the second difference along y,

gives 0 on every picture f(x) + g(y) + x h(y) + y k(x): on planes, ramps, and straight edges along an axis. On
independent noise of deviation s it has the deviation 6 s (the root of the sum of its squares, 36). Shadows' edges
excite it too, but few samples lie on them, and the median of |N * v| instead of its mean passes them over.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.photo.observation import Observation

MASK = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
NORM = 6.0  # root of the sum of the mask's squares
MEDIAN_OF_NORMAL = 0.6744897501960817  # the median of |x| where x is normal with deviation 1


def sample_noise(observation: Observation, samples: tuple[int, int]) -> Float[Tensor, "*batch channels"]:
    """Returns the standard deviation of the samples' noise, in their own units; NaN where no 3 x 3 samples are used.

    s = median |N * v| / (6 0.6745) over the samples whose eight neighbours have a weight above 0 too. Of n such places
    about n / 6 are independent, so that s is known to about 1.2 sqrt(6 / n): 5 % for 64 x 64 samples. Neighbours that
    share pixels of the photograph are correlated by c > 0, which makes s smaller by about 4 c / 3.

    Args:
        observation: samples and weights.
        samples: the receiver's columns and rows.

    Raises:
        ShapeError: the observation has another number of samples.
    """
    columns, rows = samples
    values = observation.samples
    if values.shape[-1] != columns * rows:
        raise ShapeError(f"noise: expected {columns} x {rows} samples, got {values.shape[-1]}")
    mask = torch.tensor(MASK, dtype=values.dtype, device=values.device)
    pictures = values.reshape(-1, 1, rows, columns)
    used = (observation.weights > 0).to(values).reshape(-1, 1, rows, columns)
    response = torch.nn.functional.conv2d(pictures, mask[None, None]).abs() / (NORM * MEDIAN_OF_NORMAL)
    whole = torch.nn.functional.conv2d(used, torch.ones_like(mask)[None, None]) > 8.5
    response = response.reshape(*values.shape[:-1], -1)
    whole = whole.reshape(*values.shape[:-2], 1, -1)
    return torch.where(whole, response, torch.nan).nanmedian(dim=-1).values
