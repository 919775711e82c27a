"""The rule "gain": best-first growth by projected gain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.inversion import growth, lockstep
from torchlight.inversion.forest import Forest, Items, harvest, seedlings
from torchlight.inversion.growth import SMALL, Pace
from torchlight.inversion.nodes import product
from torchlight.inversion.outcome import Group, Outcome
from torchlight.inversion.refinement import Bounds
from torchlight.threads import ordered_map, thread_count

MOST_ITEMS = 32  # that one call of the kernel grows: more would leave a processor idle at the end


@dataclass(frozen=True)
class ProjectedGain:
    """Divides the leaf that lowers the squared residual most, again and again; all leaves stay candidates.

    Attributes:
        threshold: tau: least gain of a trio, in squared sigmas.
        share: of the possible divisions made between two fits; smaller is greedier and slower.
        spare: leaves that a small tree may grow beyond the budget before it is pruned to it; 0 = no pruning.
        shared: whether the channels of a photograph use the same functions, those that serve all of them best.
    """

    threshold: float = 8.0
    share: float = 0.05
    spare: int = 18
    shared: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.threshold < float("inf"):
            raise ConfigError(f"ProjectedGain.threshold: expected a number of at least 0, got {self.threshold}")
        if not 0.0 < self.share <= 1.0:
            raise ConfigError(f"ProjectedGain.share: expected a number in (0, 1], got {self.share}")
        if self.spare < 0:
            raise ConfigError(f"ProjectedGain.spare: expected a number of leaves of at least 0, got {self.spare}")

    def refine(self, group: Group, bounds: Bounds) -> Outcome:
        """Returns the light, the functions in use and the certificates of every item of a group."""
        photos, channels, points = group.targets.shape
        trees = photos if self.shared else photos * channels
        items = seeds(group, group.targets.reshape(trees, -1, points))
        items, forest = grow(items, Pace(self.threshold, self.share, room(bounds.budget, self.spare)), bounds)
        return harvest(items, forest, (photos, channels))


def room(budget: int, spare: int) -> int:
    """Returns how many leaves a tree may grow to before it is pruned to the budget.

    The first few divisions are the risky ones: each is chosen before what lies below it is known. Among dozens a poor
    one hardly counts, and trees of `SMALL` leaves and more are not pruned.
    """
    return max(budget, min(budget + spare, SMALL))


def seeds(group: Group, targets: Float[Tensor, "items channels points"]) -> Items:
    """Returns the items of a group: what shares a tree, with the correlations of all squares known."""
    correlations = product(targets.flatten(0, 1), group.weighted.columns).unflatten(0, targets.shape[:2])
    sigmas = group.sigmas.repeat_interleave(targets.shape[0] // group.sigmas.shape[0])
    return Items(group.weighted, targets, correlations, sigmas)


def grow(items: Items, pace: Pace, bounds: Bounds) -> tuple[Items, Forest]:
    """Returns the grown trees, and the items with the correlations of all squares that were asked for.

    Trees grow in rounds: when some need quarters that are not known, those of all are cast together.
    """
    forest = seedlings(items, pace.room)
    waiting = torch.arange(forest.counts.shape[0], device=forest.counts.device)
    while waiting.shape[0] > 0:
        grow_some(items, forest, waiting, pace, bounds)
        waiting = forest.requests.any(dim=1).nonzero()[:, 0]
        items = follow(items, forest.leaves[forest.requests > 0])
    return items, forest


def follow(items: Items, places: Int[Tensor, " k"]) -> Items:
    """Returns the items with the quarters of these squares known."""
    if places.shape[0] == 0:
        return items
    fresh = items.weighted.divide(places)
    correlations = product(items.targets.flatten(0, 1), fresh).unflatten(0, items.targets.shape[:2])
    return replace(items, correlations=torch.cat([items.correlations, correlations], dim=-1))


def grow_some(items: Items, forest: Forest, waiting: Int[Tensor, " k"], pace: Pace, bounds: Bounds) -> None:
    """Grows the trees of some items in place: by the kernel on the CPU, elsewhere all of them in lockstep."""
    if items.targets.device.type == "cpu":
        for _ in ordered_map(lambda part: grow_compiled(items, forest, part, pace, bounds), parts(waiting)):
            pass
    else:
        lockstep.grow(items, forest, waiting, pace, bounds)


def parts(waiting: Int[Tensor, " k"]) -> Iterator[Int[Tensor, " part"]]:
    """Yields the items in pieces small enough to keep all processors busy."""
    size = max(1, min(MOST_ITEMS, waiting.shape[0] // (4 * thread_count())))
    yield from waiting.split(size)


def grow_compiled(items: Items, forest: Forest, waiting: Int[Tensor, " k"], pace: Pace, bounds: Bounds) -> None:
    """Grows the trees of some items in place, by the compiled kernel."""
    from torchlight.inversion.growth_kernel import grow_items  # numba is imported only where it is used

    weighted = items.weighted
    part = [getattr(forest, name)[waiting] for name in ("leaves", "counts", "values", "fates", "requests", "steps")]
    sizes = torch.linalg.vector_norm(items.targets[waiting], dim=-1)
    grow_items(
        weighted.gram_and_room.numpy(),
        weighted.children.numpy(),
        weighted.parent.numpy(),
        growth.areas(items).numpy(),
        weighted.source.tree.level[weighted.node].numpy(),
        items.correlations[waiting].numpy(),
        torch.where(sizes > 0, sizes, 1.0).numpy(),
        items.sigmas[waiting].numpy(),
        pace.threshold,
        pace.share,
        bounds.budget,
        bounds.condition_limit,
        *(tensor.numpy() for tensor in part),
    )
    for name, tensor in zip(("leaves", "counts", "values", "fates", "requests", "steps"), part, strict=True):
        getattr(forest, name)[waiting] = tensor
