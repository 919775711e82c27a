"""Pictures from coarse to fine: cells of many pixels first, smaller ones where their values bend.

At every level a cell is computed where its surroundings, a level coarser, show different things or bend by more than
a tolerance; elsewhere it is interpolated. A cell's value is a mean over its area, so that what is smaller than a cell
is not overlooked unless it changes the mean by less than the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.insertion.sight import Sight
from torchlight.threads import single_threaded_map

COARSEST = 20_000  # cells, about
MOST = 1_500_000  # cells computed in all; beyond it the last levels are interpolated
TOLERANCE = 1 / 255
BLOCK = 2048  # cells at once
Progress = Callable[[int, int], None]
Computed = tuple[Float[Tensor, "cells values"], Int[Tensor, " cells"]]
Task = Callable[[Sight, Int[Tensor, " cells"]], Computed]


@dataclass(frozen=True, eq=False)
class Picture:
    """Values at every pixel.

    Attributes:
        values: as computed or interpolated.
        kind: what each pixel shows; 0 = nothing known.
    """

    values: Float[Tensor, "values height width"]
    kind: Int[Tensor, "height width"]


@dataclass
class Steps:
    """Counts cells for a progress bar; the total is a guess that grows."""

    progress: Progress | None
    total: int
    done: int = 0

    def add(self, count: int) -> None:
        """Counts some more."""
        self.done += count
        self.total = max(self.total, self.done)
        if self.progress is not None:
            self.progress(self.done, self.total)


def refined(sight: Sight, task: Task, judged: int, steps: Steps) -> Picture:
    """Returns a task's values at every pixel of a view.

    Args:
        sight: the view, in pixels.
        task: (the view in cells, numbers of cells) -> values and kinds of these cells.
        judged: how many of the values, the first ones, say where to refine.
        steps: of the progress bar.
    """
    step = coarsest_step(sight.size)
    here = sight.coarser(step)
    index = torch.arange(here.cells)
    picture = _filled(here, index, *computed(here, index, task, steps), None)
    spent = len(index)
    while step > 1:
        step //= 2
        here = sight.coarser(step)
        wanted = differing(picture, judged)
        index = _finer(wanted, here.grid).flatten().nonzero()[:, 0]
        spent += len(index)
        index = index if spent <= MOST else index[:0]
        picture = _filled(here, index, *computed(here, index, task, steps), _interpolated(picture, here.grid))
    return picture


def coarsest_step(size: tuple[int, int]) -> int:
    """Returns the power of two with about `COARSEST` cells."""
    step = 1
    while size[0] * size[1] > COARSEST * step * step:
        step *= 2
    return step


def computed(sight: Sight, index: Int[Tensor, " cells"], task: Task, steps: Steps) -> Computed:
    """Returns a task's values and kinds for some cells, block by block on all processors."""
    parts = index.split(BLOCK)
    values, kinds = [], []
    for value, kind in single_threaded_map(lambda part: task(sight, part), parts):
        values.append(value)
        kinds.append(kind)
        steps.add(len(kind))
    return torch.cat(values), torch.cat(kinds)


def differing(picture: Picture, judged: int) -> Bool[Tensor, "height width"]:
    """Returns the cells beside which interpolation would not do: something else is shown, or the values bend.

    Between cells a linear interpolation is wrong by an eighth of the second difference; it may be `TOLERANCE`.
    """
    kind = picture.kind[None, None].double()
    other = _largest(kind) + _largest(-kind) > 0
    grid = torch.nn.functional.pad(picture.values[None, :judged], (1, 1, 1, 1), mode="replicate")[0]
    down = (grid[:, 2:, 1:-1] - 2 * grid[:, 1:-1, 1:-1] + grid[:, :-2, 1:-1]).abs()
    across = (grid[:, 1:-1, 2:] - 2 * grid[:, 1:-1, 1:-1] + grid[:, 1:-1, :-2]).abs()
    bend = _largest(torch.maximum(down, across).amax(dim=0)[None, None])
    return (other | (bend > TOLERANCE))[0, 0]


def _largest(layers: Float[Tensor, "1 1 rows columns"]) -> Float[Tensor, "1 1 rows columns"]:
    return torch.nn.functional.max_pool2d(layers, kernel_size=3, stride=1, padding=1)


def _finer(mask: Bool[Tensor, "rows columns"], grid: tuple[int, int]) -> Bool[Tensor, "finer_rows finer_columns"]:
    """Returns the mask on cells of half the edge."""
    return mask.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)[: grid[1], : grid[0]]


def _interpolated(picture: Picture, grid: tuple[int, int]) -> Picture:
    """Returns a picture on cells of half the edge, bilinear; beyond its outermost centres it is constant."""
    columns, rows = grid
    high, wide = picture.kind.shape
    x, y = ((torch.arange(count, dtype=torch.float64) + 0.5) / 2 for count in (columns, rows))
    place = torch.stack(torch.meshgrid(x * 2 / wide - 1, y * 2 / high - 1, indexing="xy"), dim=-1)
    values = torch.nn.functional.grid_sample(
        picture.values[None], place[None], mode="bilinear", padding_mode="border", align_corners=False
    )[0]
    return Picture(values, picture.kind.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)[:rows, :columns])


def _filled(
    sight: Sight,
    index: Int[Tensor, " cells"],
    values: Float[Tensor, "cells values"],
    kind: Int[Tensor, " cells"],
    under: Picture | None,
) -> Picture:
    """Returns computed cells over what was interpolated."""
    columns, rows = sight.grid
    if under is None:
        return Picture(values.T.reshape(-1, rows, columns), kind.reshape(rows, columns))
    below, kinds = under.values.flatten(start_dim=1).clone(), under.kind.flatten().clone()
    below[:, index], kinds[index] = values.T, kind
    return Picture(below.reshape(-1, rows, columns), kinds.reshape(rows, columns))
