"""How much each further photograph of one light adds to those before it, by what `torchlight analyze` measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.analysis.nullity import TOLERANCE, Nullity, equations, nullity
from torchlight.analysis.observability import Observability, coarsened, observability, stacked, whitened
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.transfer import Transfer

DETAIL = 16  # texels along a face's edge of the observability


@dataclass(frozen=True, eq=False)
class Determined:
    """What a set of photographs determines.

    Attributes:
        curve: nullity of their samples.
        seen: observability at 16 x 16.
    """

    curve: Nullity
    seen: Observability

    def undetermined(self, bandwidth: int) -> float:
        """Returns the mean nullity at the recommended tolerance: directions of a light of that bandwidth not known."""
        return self.curve.mean[self.curve.tolerances.index(TOLERANCE), bandwidth - 1].item()


@dataclass(frozen=True, eq=False)
class Added:
    """What each photograph determines alone, and the first 1, 2, ... of them together.

    Attributes:
        alone: of each photograph.
        together: of the first k photographs at place k - 1.
    """

    alone: tuple[Determined, ...]
    together: tuple[Determined, ...]

    def telling_bandwidth(self) -> int:
        """Returns the bandwidth at which nullities tell best apart what the photographs determine.

        It is the one recommended for all together where that is more than for the first alone, else the next larger.
        """
        before, after = self.together[0].curve.recommended(), self.together[-1].curve.recommended()
        return after if after > before else min(after + 1, self.together[0].curve.unknowns.shape[0])


def added(
    transfers: Sequence[Transfer],
    used: Sequence[Bool[Tensor, " _"]],
    bandwidth_max: int,
    rotations: Float[Tensor, "rotations 3 3"],
    noise: float,
) -> Added:
    """Returns what photographs determine, one by one and together.

    Args:
        transfers: of each photograph's scene, all at one resolution.
        used: which of its samples count.
        bandwidth_max: largest bandwidth of the nullity curves.
        rotations: of the sampling directions.
        noise: standard deviation per sample, as a share of the brightest sample.
    """
    rows = [
        equations(transfer_harmonics(transfer, bandwidth_max - 1), len(part))[part]
        for transfer, part in zip(transfers, used, strict=True)
    ]
    white = [whitened(coarsened(transfer, DETAIL), part, noise) for transfer, part in zip(transfers, used, strict=True)]

    def of(group: slice) -> Determined:
        return Determined(nullity(torch.cat(rows[group]), rotations), observability(stacked(white[group])))

    alone = tuple(of(slice(index, index + 1)) for index in range(len(rows)))
    return Added(alone, (alone[0], *(of(slice(count)) for count in range(2, len(rows) + 1))))
