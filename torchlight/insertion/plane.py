"""What the new shadow leaves of every pixel: the ratio image, on the plane and on the objects that are there.

    r = (without - lost) / without          exactly 1 where the new object hides nothing

A pixel that shows the plane, or an old object, at one of its rays gets the ratio of those rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.insertion.cells import Cells, as_seen_from
from torchlight.insertion.gathering import Received, receive
from torchlight.insertion.looking import OLD, PLANE, Seen
from torchlight.insertion.stage import Stage
from torchlight.light_plane import LightPlane


@dataclass(frozen=True, eq=False)
class Lamp:
    """A light as cells, and where it stands."""

    cells: Cells
    plane: LightPlane | None = None

    def seen_from(self, point: Float[Tensor, "3"]) -> Cells:
        """Returns the cells in the directions in which a point sees them."""
        return as_seen_from(self.cells, self.plane, point)


def behind(seen: Seen) -> Int[Tensor, " cells"]:
    """Returns whether each cell shows the plane or an old object, by its most central ray that shows one; else 0."""
    shows = (seen.kind == PLANE) | (seen.kind == OLD)
    first = seen.kind.gather(1, shows.float().argmax(dim=1, keepdim=True))[:, 0]
    return torch.where(shows.any(dim=1), first, 0).long()


def receive_behind(seen: Seen, kind: Int[Tensor, " cells"], stage: Stage, lamp: Lamp) -> Received:
    """Returns what the plane, or the old object, of each cell receives; 0 where it shows neither."""
    values = torch.zeros(3, len(kind), 3, dtype=torch.float64)
    sources = {PLANE: (lamp.cells, stage.over_plane), OLD: (lamp.seen_from(stage.middle[0]), stage.over_objects)}
    for which, (cells, blockers) in sources.items():
        rows = kind == which
        if bool(rows.any()):
            found = receive(seen.only(rows, which), cells, blockers)
            values[:, rows] = torch.stack([found.open, found.without, found.lost])
    return Received(*values)


def darkened(received: Received) -> Float[Tensor, "points 3"]:
    """Returns 1 - r in [0, 1]; 0 where there is nothing to lose."""
    some = received.without > 0
    return torch.where(some, received.lost / torch.where(some, received.without, 1.0), 0.0).clamp(0, 1)
