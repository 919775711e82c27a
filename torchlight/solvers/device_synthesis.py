"""Least squares over S x >= 0 for many items in lockstep, where there is no compiled code: on a GPU."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.solvers.active_set import Limits
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.device_steps import alike, minimizers
from torchlight.solvers.synthesis import DUAL_TOLERANCE, Diagonal, NonnegativeSynthesis, optimality

Answers = tuple[Float[Tensor, "items coeffs"], Int[Tensor, " items"], Float[Tensor, "items 2"], Bool[Tensor, " items"]]


def lockstep_synthesis(
    settings: NonnegativeSynthesis, program: Diagonal, targets: Float[Tensor, "items points"]
) -> Answers:
    """Returns u, the steps, (kkt_residual, gap) and whether it converged, for every item.

    The rounds are those of `NonnegativeSynthesis`, of all items together; the dual programs of a round share their Gram
    matrix. The host waits once a round to learn whether there is another. A round starts at the last one's multipliers.
    """
    size = nonzero_norm(targets)[:, None]
    seen = targets / size @ program.left
    gram = program.cone.T @ program.cone
    u, multipliers = torch.zeros_like(seen), seen.new_zeros(seen.shape[0], gram.shape[0])
    figures = seen.new_full((seen.shape[0], 2), torch.inf)
    steps = torch.zeros_like(seen[:, 0], dtype=torch.int64)
    for _ in range(settings.max_rounds):
        going = (figures[:, 0] > settings.tolerance) & (steps < settings.max_steps)
        if not bool(going.any()):
            break
        center = (program.values * seen + program.shift * u) / program.scale
        length = nonzero_norm(center)[:, None]
        limits = Limits(DUAL_TOLERANCE, settings.max_steps, most_entrants=1)
        # what is not going any more begins at its end
        found, spent = minimizers(alike(gram, -(center @ program.cone) / length), multipliers / length, 0.0, limits)
        multipliers = torch.where(going[:, None], found * length, multipliers)
        u = torch.where(going[:, None], (center + multipliers @ program.cone.T) / program.scale, u)
        now = torch.stack(optimality(program, seen, u, multipliers / program.cone_norms), dim=-1)
        figures = torch.where(going[:, None], now, figures)
        steps = steps + torch.where(going, spent, 0)
    return u * size, steps, figures, figures[:, 0] <= settings.tolerance
