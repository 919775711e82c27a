"""Adaptive Haar: light in few wavelets, finer where, and only where, the shadows can tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.leaf_program import TOLERANCE, Columns, Item, certificate, leaf_wavelets, scene_columns
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.quadtree import Quadtree, quadtree
from torchlight.inversion.refinement import Bounds, Fate, Grown, Refinement
from torchlight.light.bases import HaarCubemap
from torchlight.photo.observation import Observation
from torchlight.solvers import LeastSquares, Solution, Status
from torchlight.solvers.system import assemble, binary_scale, by_weights, initial_status, photo_weights
from torchlight.transfer import Transfer

CONSTANTS = 9
MAX_DENSE_RESOLUTION = 32
FIGURES = 3


@runtime_checkable
class Rule(Protocol):
    """Decides which supports are divided and which wavelets stay: `ProjectedGain` or `LevelByLevel`."""

    def refine(self, item: Item, bounds: Bounds) -> Grown:
        """Returns the tree, the functions in use and the light of one item."""
        ...


def named_rule(name: str) -> Rule:
    """Returns the rule behind a name of the command line: "gain" or "paper".

    Raises:
        ConfigError: the name is unknown.
    """
    if name == "gain":
        return ProjectedGain()
    if name == "paper":
        return LevelByLevel()
    raise ConfigError(f"--rule: expected gain or paper, got '{name}'")


@dataclass(frozen=True)
class AdaptiveHaar:
    """Non-negative light in at most `budget` Haar functions, chosen per photograph and channel.

    Attributes:
        max_resolution: texels along a cube edge at the finest level, a power of two up to 32.
        budget: most functions: nine constants and the wavelets kept.
        noise: standard deviation of a sample's noise, as a share of the photograph's brightest sample.
        rule: which functions are used: `ProjectedGain` or `LevelByLevel`.
        condition_limit: kappa: a trio joins if changing it by kappa times the radiance there moves the photograph by
            at least one sigma in a way that no other function in use can.
    """

    max_resolution: int = 16
    budget: int = 120
    noise: float = 0.4 / 255
    rule: Rule = ProjectedGain()  # noqa: RUF009  (frozen settings)
    condition_limit: float = 10.0

    def __post_init__(self) -> None:
        size = self.max_resolution
        if not 2 <= size <= MAX_DENSE_RESOLUTION or size & (size - 1):
            raise ConfigError(f"AdaptiveHaar.max_resolution: expected 2, 4, 8, 16 or 32, got {size}; 16 is usual")
        if self.budget < CONSTANTS:
            raise ConfigError(f"AdaptiveHaar.budget: expected at least {CONSTANTS} functions, got {self.budget}")
        if not 0.0 < self.noise < 1.0:
            raise ConfigError(f"AdaptiveHaar.noise: expected a number in (0, 1), got {self.noise}; 8 bits: 0.0016")
        if not self.condition_limit > 0.0:
            raise ConfigError(f"AdaptiveHaar.condition_limit: expected a positive number, got {self.condition_limit}")

    @property
    def basis(self) -> HaarCubemap:
        """What the coefficients multiply."""
        return HaarCubemap(self.max_resolution)


@dataclass(frozen=True, eq=False)
class AdaptiveSolution:
    """Haar coefficients with their certificates, and what was decided on the way.

    Attributes:
        solution: coefficients of the complete basis, 0 for functions not in use. kkt_residual and gap refer to the
            program of the functions in use: S c >= 0; steps to the last of its many fits.
        refinement: functions in use, fates of supports.
    """

    solution: Solution
    refinement: Refinement


def solve_adaptive(transfer: Transfer, observation: Observation, settings: AdaptiveHaar) -> AdaptiveSolution:
    """Returns light in few Haar functions for every photograph and channel; a failed item is a status.

    kkt_residual of an item: with A and b weighted, v >= 0 the radiance on the leaves of its tree, D v = 0 the wavelets
    left out, l their multipliers and w = A'(b - A v) - D'l, the largest of max_j w_j / (|a_j| |b|),
    max_j -v_j |a_j| / |b|, sum_j |v_j w_j| / |b|^2 and the largest |D v|, scaled to the other three.

    Raises:
        ShapeError: the transport has another resolution than the settings.
    """
    if transfer.resolution != settings.max_resolution:
        raise ShapeError(
            f"adaptive: max_resolution is {settings.max_resolution}, the transport's {transfer.resolution}; "
            "precompute the scene at max_resolution"
        )
    matrix = transfer.transport
    problem = LeastSquares(matrix, observation.samples.to(matrix), observation.weights.to(matrix))
    tree = quadtree(settings.max_resolution, device=matrix.device)
    weights = photo_weights(problem)
    samples = problem.samples.reshape(-1, *problem.samples.shape[-2:]).to(torch.float64)
    samples = torch.where(weights[:, None, :] > 0, samples, 0.0)
    status = initial_status(samples, weights)
    found = torch.zeros(*status.shape, matrix.shape[1] + FIGURES, dtype=torch.float64, device=matrix.device)
    found[..., matrix.shape[1] :] = torch.nan
    steps = torch.zeros_like(status)
    refinement = empty_refinement(tree, status)
    for photo, columns in photos_with_columns(tree, matrix, weights, status):
        noise = settings.noise * samples[photo][status[photo] == Status.CONVERGED].abs().max()
        for channel in (status[photo] == Status.CONVERGED).nonzero()[:, 0].tolist():
            scale = binary_scale(samples[photo, channel][None])[0]
            item = make_item(columns, samples[photo, channel] / scale, (noise / scale).item())
            grown = settings.rule.refine(item, Bounds(settings.budget, settings.condition_limit))
            figures = certificate(item, grown.divided, grown.kept, grown.fitted)
            found[photo, channel] = torch.cat([coefficients(tree, grown) * scale, figures])
            steps[photo, channel] = grown.fitted.steps
            converged = bool(figures[1] <= TOLERANCE)
            status[photo, channel] = int(Status.CONVERGED if converged else Status.STOPPED_SHORT)
            refinement.kept[photo, channel] = grown.kept
            refinement.fate[photo, channel] = grown.fate
            refinement.regions[photo, channel] = grown.fitted.leaves.shape[0]
    return AdaptiveSolution(assemble(problem, found, status, steps), shaped(refinement, problem.samples.shape[:-1]))


def photos_with_columns(
    tree: Quadtree,
    matrix: Float[Tensor, "points texels"],
    weights: Float[Tensor, "photos points"],
    status: Int[Tensor, "photos channels"],
) -> Iterator[tuple[int, Columns]]:
    """Yields every solvable photograph with the columns it shares with all of equal weights."""
    for photos in by_weights(weights):
        solvable = [photo for photo in photos.tolist() if bool((status[photo] == Status.CONVERGED).any())]
        if solvable:
            columns = scene_columns(tree, matrix, weights[solvable[0]].sqrt())
            yield from ((photo, columns) for photo in solvable)


def make_item(columns: Columns, samples: Float[Tensor, " points"], sigma: float) -> Item:
    """Returns one channel of one photograph, ready to be fitted."""
    target = samples * columns.root
    return Item(columns, target, target @ columns.nodes, sigma)


def coefficients(tree: Quadtree, grown: Grown) -> Float[Tensor, " coeffs"]:
    """Returns the Haar coefficients, exactly 0 for functions not in use."""
    return torch.where(grown.kept, grown.fitted.values @ leaf_wavelets(tree, grown.fitted.leaves), 0.0)


def empty_refinement(tree: Quadtree, status: Int[Tensor, "photos channels"]) -> Refinement:
    """Returns what holds for items that fail: no function in use."""
    kept = torch.zeros(*status.shape, 3 * tree.resolution**2, dtype=torch.bool, device=status.device)
    fate = torch.full((*status.shape, tree.supports.shape[0]), int(Fate.UNSOLVED), device=status.device)
    return Refinement(kept, fate, torch.zeros_like(status))


def shaped(refinement: Refinement, items: torch.Size) -> Refinement:
    """Returns the decisions in the shape of the observation's batch."""
    return Refinement(
        kept=refinement.kept.reshape(*items, -1),
        fate=refinement.fate.reshape(*items, -1),
        regions=refinement.regions.reshape(items),
    )
