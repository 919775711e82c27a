"""The light that points of the scene receive from a light's cells, with the new object and without it.

    open    = sum over cells of P max(0, n.l)                       no object anywhere
    without = sum of P max(0, n.l) (1 - old)                        the objects that are there
    lost    = sum of P max(0, n.l) (1 - old) new                    what the new object takes away

old and new are 1 where such an object hides the direction l. Cell i is asked at ray i mod S of the S rays of a pixel:
every cell counts once, and over the cells the pixel's whole area is covered, so that edges of shadows are not jagged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.footprints import spiral_directions
from torchlight.insertion.cells import Cells
from torchlight.insertion.looking import Seen
from torchlight.insertion.shading import Material, glossy
from torchlight.insertion.stage import Blockers

BOUNCES = 256  # directions to the plane


@dataclass(frozen=True, eq=False)
class Received:
    """What points receive, each integrated over the light: irradiances, as above."""

    open: Float[Tensor, "points 3"]
    without: Float[Tensor, "points 3"]
    lost: Float[Tensor, "points 3"]


@dataclass(frozen=True, eq=False)
class Thrown:
    """What points of the new object throw to the viewer.

    Attributes:
        irradiance: that they receive.
        lobe: radiance of a glossy lobe of share 1.
    """

    irradiance: Float[Tensor, "points 3"]
    lobe: Float[Tensor, "points 3"]


@dataclass(frozen=True, eq=False)
class _Part:
    """Some cells at one ray of every pixel."""

    normals: Float[Tensor, "points 3"]
    toward: Float[Tensor, "points 3"]
    directions: Float[Tensor, "cells 3"]
    powers: Float[Tensor, "cells 3"]
    cosine: Float[Tensor, "points cells"]
    asked: Bool[Tensor, "points cells"]
    starts: Float[Tensor, "points 3"]


def receive(seen: Seen, cells: Cells, blockers: Blockers) -> Received:
    """Returns what points of the plane, or of the objects that are there, receive."""
    totals = torch.zeros(3, len(seen.kind), 3, dtype=torch.float64)
    for part in _parts(seen, cells, blockers):
        dark = blockers.old.hides(part.starts, part.directions, part.asked) | ~part.asked
        lost = blockers.new.hides(part.starts, part.directions, ~dark)
        reaching = part.cosine * ~dark
        totals += torch.stack([(v @ part.powers).double() for v in (part.cosine, reaching, reaching * lost)])
    return Received(*totals)


def throw(seen: Seen, cells: Cells, blockers: Blockers, material: Material) -> Thrown:
    """Returns what points of the new object throw back, lit where neither an old object nor itself is in the way."""
    irradiance, lobe = torch.zeros(2, len(seen.kind), 3, dtype=torch.float64)
    for part in _parts(seen, cells, blockers):
        free = unhidden(part, blockers)
        irradiance += ((part.cosine * free) @ part.powers).double()
        if material.gloss > 0:
            shine = glossy(part.normals, part.toward, part.directions, material.roughness)
            lobe += ((shine * free) @ part.powers).double()
    return Thrown(irradiance, lobe)


def unhidden(part: _Part, blockers: Blockers) -> Bool[Tensor, "points cells"]:
    """Returns where nothing stands in the way."""
    free = part.asked & ~blockers.new.hides(part.starts, part.directions, part.asked)
    return free & ~blockers.old.hides(part.starts, part.directions, free)


def throw_bounced(seen: Seen, ground: Ground, blockers: Blockers, material: Material) -> Thrown:
    """Returns what points of the new object throw back of the plane's own light: one bounce."""
    down = torch.from_numpy(spiral_directions(BOUNCES)).float() * torch.tensor([1.0, 1.0, -1.0])
    cells = Cells(down, torch.full((BOUNCES, 3), 2 * torch.pi / BOUNCES))
    irradiance, lobe = torch.zeros(2, len(seen.kind), 3, dtype=torch.float64)
    for sub, part in enumerate(_parts(seen, cells, blockers)):
        free = unhidden(part, blockers)
        points = seen.points[:, sub].float()
        reach = points[:, None, 2:] / part.directions[None, :, 2:]
        shown = ground.radiance_at(points[:, None, :2] - reach * part.directions[None, :, :2])
        light = shown * part.powers[0, 0]
        irradiance += torch.einsum("pc,pck->pk", part.cosine * free, light).double()
        if material.gloss > 0:
            shine = glossy(part.normals, part.toward, part.directions, material.roughness)
            lobe += torch.einsum("pc,pck->pk", shine * free, light).double()
    return Thrown(irradiance, lobe)


@dataclass(frozen=True, eq=False)
class Ground:
    """The plane's own radiance, for the bounce: a grid over the receiver, row 0 at its smallest y, and beyond it.

    Attributes:
        grid: radiance in the photograph's linear unit.
        beyond: radiance outside the receiver.
        center: of the receiver.
        size: of the receiver.
    """

    grid: Float[Tensor, "rows columns 3"]
    beyond: Float[Tensor, "3"]
    center: tuple[float, float]
    size: tuple[float, float]

    def radiance_at(self, points: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 3"]:
        """Returns the radiance of the sample that each point lies on."""
        rows, columns = self.grid.shape[:2]
        share = (points - torch.tensor(self.center)) / torch.tensor(self.size) + 0.5
        on = ((share >= 0) & (share < 1)).all(dim=-1)
        place = torch.where(on[..., None], share, 0.0)
        row, column = (place[..., 1] * rows).long(), (place[..., 0] * columns).long()
        return torch.where(on[..., None], self.grid[row, column], self.beyond)


def _parts(seen: Seen, cells: Cells, blockers: Blockers) -> Iterator[_Part]:
    subs = seen.kind.shape[1]
    for sub in range(subs):
        directions, powers = cells.directions[sub::subs], cells.powers[sub::subs]
        normals, facing = seen.normals[:, sub].float(), seen.facing[:, sub]
        cosine = (normals @ directions.T).clamp(min=0)
        asked = (cosine > 0) & (facing.float() @ directions.T > 0)
        starts = blockers.starts(seen.points[:, sub], facing)
        yield _Part(normals, seen.toward[:, sub].float(), directions, powers, cosine, asked, starts)
