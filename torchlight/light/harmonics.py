"""Real spherical harmonics: orthonormal, without the Condon-Shortley phase, index l (l + 1) + m."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor


def real_spherical_harmonics(
    degree: int, directions: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch {(degree+1)**2}"]:
    """Returns Y_lm of every direction for l = 0 .. degree, at index l (l + 1) + m.

        Y_lm = sqrt(2) K_l|m| P_l|m|(cos theta) {cos m phi (m > 0), sin |m| phi (m < 0)},   Y_l0 = K_l0 P_l(cos theta)

    with K such that the integral of Y^2 over the sphere is 1, and P without (-1)^m. The factor sin^m theta of P is
    taken together with cos m phi and sin m phi, so that (x + iy)^m appears and nothing is singular at the poles.
    Computed in float64 whatever the input's dtype.

    Args:
        degree: largest l.
        directions: unit vectors.

    References:
        The recurrence in l at fixed m for normalised functions: Press et al., Numerical Recipes, 3rd ed. (2007),
        section 6.7.
    """
    x, y, z = directions.double().unbind(dim=-1)
    columns: list[Tensor] = [z] * (degree + 1) ** 2
    real, imaginary = torch.ones_like(z), torch.zeros_like(z)
    sectoral = math.sqrt(1 / (4 * math.pi))
    for m in range(degree + 1):
        for order, polynomial in enumerate(_polynomials(m, degree, sectoral, z), start=m):
            middle = order * (order + 1)
            columns[middle + m] = polynomial * real
            if m > 0:
                columns[middle - m] = polynomial * imaginary
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real
        # The step from m = 0 to 1 also brings in the sqrt(2) of the pair (cos, sin).
        sectoral *= math.sqrt((2 * m + 3) / (2 * m + 2)) * (math.sqrt(2) if m == 0 else 1.0)
    return torch.stack(columns, dim=-1).to(directions.dtype)


def _polynomials(m: int, degree: int, sectoral: float, z: Float[Tensor, "*batch"]) -> list[Float[Tensor, "*batch"]]:
    """Returns the normalised P_lm(z) / sin^m theta for l = m .. degree; `sectoral` is the constant at l = m."""
    values = [torch.full_like(z, sectoral)]
    previous, factor = torch.zeros_like(z), 0.0
    for l in range(m + 1, degree + 1):
        next_factor = math.sqrt((l * l - m * m) / (4 * l * l - 1))
        values.append((z * values[-1] - factor * previous) / next_factor)
        previous, factor = values[-2], next_factor
    return values
