"""A camera's response from photographs of one view at several exposures.

P. Debevec and J. Malik, "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 1997: g = ln x, the
logarithm of the exposure that a code stands for, minimises

    sum_ij (w(z_ij) (g(z_ij) - ln E_i - ln t_j))^2 + lambda^2 sum_z (w(z) g''(z))^2,   g(middle code) = 0

with w the hat function. The ln E_i are eliminated in closed form, which leaves one small system in g, in float64.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.photo.radiometry import Response

CODES = 256
SMOOTHNESS = 30.0  # lambda, for as many pixels as DATA_PIXELS; scripts/merge_check.py shows what it does
DATA_PIXELS = 100
LEAST_RISE = 1e-4  # in ln x per code: keeps a response increasing where noise makes it fall


def estimate_response(
    codes: Int[Tensor, "photos 3 pixels"], exposures: Float[Tensor, " photos"], smoothness: float = SMOOTHNESS
) -> Response:
    """Returns the response of the camera that took brackets, per channel.

    Args:
        codes: stored codes 0 to 255 of the same pixels in every photograph; a few thousand pixels spread over the
            picture are plenty.
        exposures: exposure of every photograph, any unit.
        smoothness: lambda.

    Raises:
        ConfigError: fewer than two different exposures.
    """
    if len(exposures) < 2 or bool((exposures == exposures[0]).all()):
        raise ConfigError("the response cannot be estimated from photographs of one exposure; take at least two")
    logarithms = exposures.double().log()
    curves = [_log_response(codes[:, channel].long(), logarithms, smoothness) for channel in range(codes.shape[1])]
    exposure = torch.stack([increasing(curve) for curve in curves]).exp()
    return Response(exposure / exposure[:, -1:])


def _log_response(
    codes: Int[Tensor, "photos pixels"], logarithms: Float[Tensor, " photos"], smoothness: float
) -> Float[Tensor, "256"]:
    weight = hat() ** 2
    data = weight[codes] * (DATA_PIXELS / codes.shape[1])
    total = data.sum(dim=0).clamp(min=1e-30)
    # normal equations with every ln E_i eliminated: diag(a) - sum_i a_i a_i' / |a_i|
    rows = torch.zeros(codes.shape[1], CODES, dtype=torch.float64)
    rows.scatter_add_(1, codes.T, (data / total.sqrt()).T.contiguous())
    diagonal = torch.zeros(CODES, dtype=torch.float64).scatter_add_(0, codes.flatten(), data.flatten())
    matrix = diagonal.diag() - rows.T @ rows
    told = data * (logarithms[:, None] - (data * logarithms[:, None]).sum(dim=0) / total)
    right = torch.zeros(CODES, dtype=torch.float64).scatter_add_(0, codes.flatten(), told.flatten())
    bend = smoothness * hat()[1:-1, None] * second_differences()
    matrix = matrix + bend.T @ bend
    middle = CODES // 2
    matrix[middle, middle] += 1  # g(middle) = 0, which the data leave open
    return torch.linalg.solve(matrix, right)


def hat() -> Float[Tensor, "256"]:
    """Returns Debevec and Malik's weights of the codes, 0 at both ends and 1 in the middle."""
    codes = torch.arange(CODES, dtype=torch.float64)
    return torch.minimum(codes, CODES - 1 - codes) / (CODES // 2 - 1)


def second_differences() -> Float[Tensor, "254 256"]:
    """Returns the matrix of g(z - 1) - 2 g(z) + g(z + 1)."""
    matrix = torch.zeros(CODES - 2, CODES, dtype=torch.float64)
    index = torch.arange(CODES - 2)
    matrix[index, index], matrix[index, index + 1], matrix[index, index + 2] = 1.0, -2.0, 1.0
    return matrix


def increasing(curve: Float[Tensor, " codes"]) -> Float[Tensor, " codes"]:
    """Returns the increasing curve nearest to one in least squares (pool adjacent violators)."""
    ramp = LEAST_RISE * torch.arange(len(curve), dtype=curve.dtype)
    blocks: list[tuple[float, int]] = []
    for value in (curve - ramp).tolist():
        blocks.append((value, 1))
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            (low, few), (high, more) = blocks[-2:]
            blocks[-2:] = [((low * few + high * more) / (few + more), few + more)]
    pooled = [value for value, count in blocks for _ in range(count)]
    return torch.tensor(pooled, dtype=curve.dtype) + ramp
