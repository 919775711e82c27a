"""Adaptive Haar: light in few wavelets, finer where, and only where, the shadows can tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.devices import moved
from torchlight.errors import ConfigError, ShapeError
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.nodes import DENSE_RESOLUTION, NodeColumns, WeightedNodes
from torchlight.inversion.outcome import TOLERANCE, Group, Outcome
from torchlight.inversion.refinement import Bounds, Fate, Refinement
from torchlight.light.bases import HaarCubemap
from torchlight.photo.noise import LEAST_NOISE
from torchlight.photo.observation import Observation
from torchlight.solvers import LeastSquares, Solution, Status
from torchlight.solvers.system import assemble, binary_scale, by_weights, initial_status, photo_weights
from torchlight.transfer import Transfer

CONSTANTS = 9
MAX_RESOLUTION = 512
FIGURES = 3
ENTRIES_PER_BLOCK = 2**25  # coefficients of photographs worked on together: 256 MiB
DEEP_PHOTOS = 4  # the same where squares are cast on demand: each photograph adds hundreds to thousands


@runtime_checkable
class Rule(Protocol):
    """Decides which supports are divided and which wavelets stay: `ProjectedGain` or `LevelByLevel`."""

    def refine(self, group: Group, bounds: Bounds) -> Outcome:
        """Returns the light, the functions in use and the certificates of every item of a group."""
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
        max_resolution: texels along a cube edge at the finest level, a power of two up to 512.
        budget: most functions: nine constants and the wavelets kept.
        noise: standard deviation of a sample's noise, as a share of the photograph's brightest sample; None = as
            measured for each photograph.
        rule: which functions are used: `ProjectedGain` or `LevelByLevel`.
        condition_limit: kappa: a trio joins if changing it by kappa times the radiance there moves the photograph by
            at least one sigma in a way that no other function in use can.
    """

    max_resolution: int = 128
    budget: int = 450
    noise: float | None = None
    rule: Rule = ProjectedGain()  # noqa: RUF009  (frozen settings)
    condition_limit: float = 10.0

    def __post_init__(self) -> None:
        size = self.max_resolution
        if not 2 <= size <= MAX_RESOLUTION or size & (size - 1):
            raise ConfigError(
                f"AdaptiveHaar.max_resolution: expected a power of two from 2 to {MAX_RESOLUTION}, got {size}; "
                "128 is usual"
            )
        if self.budget < CONSTANTS:
            raise ConfigError(f"AdaptiveHaar.budget: expected at least {CONSTANTS} functions, got {self.budget}")
        if self.noise is not None and not 0.0 < self.noise < 1.0:
            raise ConfigError(f"AdaptiveHaar.noise: expected a number in (0, 1), got {self.noise}; 8 bits: 0.0016")
        if not self.condition_limit > 0.0:
            raise ConfigError(f"AdaptiveHaar.condition_limit: expected a positive number, got {self.condition_limit}")

    @property
    def basis(self) -> HaarCubemap:
        """What the coefficients multiply."""
        return HaarCubemap(self.max_resolution)

    @property
    def dense_resolution(self) -> int:
        """Texels along a face's edge of the transport to solve with: `NodeColumns` casts what is finer."""
        return min(self.max_resolution, DENSE_RESOLUTION)


@dataclass(frozen=True, eq=False)
class AdaptiveSolution:
    """Haar coefficients with their certificates, what the receiver shows under them, and what was decided on the way.

    Attributes:
        solution: coefficients of the complete basis, 0 for functions not in use. kkt_residual and gap refer to the
            program of the functions in use: S c >= 0.
        irradiance: E of every sample under the light.
        refinement: functions in use, fates of supports.
        noise: of a sample, as a share of the photograph's brightest, as stated or measured.
    """

    solution: Solution
    irradiance: Float[Tensor, "*batch channels points"]
    refinement: Refinement
    noise: Float[Tensor, "*batch"]


@torch.no_grad()
def solve_adaptive(
    columns: Transfer | NodeColumns,
    observation: Observation,
    settings: AdaptiveHaar,
    measured: Float[Tensor, "*batch"] | None = None,
) -> AdaptiveSolution:
    """Returns light in few Haar functions for every photograph and channel; a failed item is a status.

    kkt_residual of an item: with A and b weighted, v >= 0 the radiance on the leaves of its tree, D v = 0 the wavelets
    left out, l their multipliers and w = A'(b - A v) - D'l, the largest of max_j w_j / (|a_j| |b|),
    max_j -v_j |a_j| / |b|, sum_j |v_j w_j| / |b|^2 and the largest |D v|, scaled to the other three.
    No gradient passes: which functions are used is a choice. `linear.solve` on those that were kept has gradients.

    Args:
        columns: of the scene. A `Transfer` must be as fine as max_resolution; `NodeColumns` cast what they lack. The
            work is done where they are; samples are brought there, and the answer back, once.
        observation: irradiance samples and weights.
        settings: how to refine.
        measured: noise of each photograph (`photo.noise.noise_share`), where the settings state none; None = 0.4 / 255.

    Raises:
        ShapeError: the columns have another resolution than the settings.
    """
    nodes = columns if isinstance(columns, NodeColumns) else NodeColumns(columns, settings.max_resolution)
    if nodes.tree.resolution != settings.max_resolution:
        raise ShapeError(
            f"adaptive: max_resolution is {settings.max_resolution}, the columns' {nodes.tree.resolution}; "
            "make them for these settings"
        )
    home, observation = observation.samples.device, moved(observation, nodes.dense.device)
    one_column = nodes.dense[:1].T.to(observation.samples.dtype)
    problem = LeastSquares(one_column, observation.samples, observation.weights.to(one_column))
    weights = photo_weights(problem)
    samples = observation.samples.reshape(-1, *observation.samples.shape[-2:]).to(torch.float64)
    samples = torch.where(weights[:, None, :] > 0, samples, 0.0)
    status = initial_status(samples, weights)
    noise = shares_of_noise(settings, observation, measured).to(samples)
    outcome = unsolved(nodes, status)
    for photos in blocks_of_photos(nodes, weights, status):
        root = weights[photos[0]].sqrt()
        solvable = status[photos] == Status.CONVERGED
        targets = torch.where(solvable[..., None], samples[photos], 0.0)
        scale = binary_scale(targets.flatten(start_dim=1))
        brightest = targets.abs().amax(dim=(1, 2)) / scale[:, 0]
        sigmas = torch.where(brightest > 0, noise[photos] * brightest, 1.0)
        group = Group(WeightedNodes(nodes, root), targets / scale[..., None] * root, sigmas)
        found = settings.rule.refine(group, Bounds(settings.budget, settings.condition_limit))
        put(outcome, photos, solvable, scaled(found, scale[..., None]))
    converged = outcome.figures[..., 1] <= TOLERANCE
    solved = status == Status.CONVERGED
    status = torch.where(solved & ~converged, int(Status.STOPPED_SHORT), status)
    return moved(assembled(outcome, observation.samples, status, noise), home)


def shares_of_noise(
    settings: AdaptiveHaar, observation: Observation, measured: Float[Tensor, "*batch"] | None
) -> Float[Tensor, " photos"]:
    """Returns each photograph's noise, of its brightest sample: as stated, else as measured, else 0.4 / 255."""
    if settings.noise is None and measured is not None:
        return measured.reshape(-1)
    stated = LEAST_NOISE if settings.noise is None else settings.noise
    return torch.full_like(observation.weights[..., 0], stated, dtype=torch.float64).reshape(-1)


def blocks_of_photos(
    nodes: NodeColumns, weights: Float[Tensor, "photos points"], status: Int[Tensor, "photos channels"]
) -> Iterator[Int[Tensor, " block"]]:
    """Yields the photographs that can be solved, those of equal weights together, as many as memory allows."""
    dense = nodes.coarse.resolution == nodes.tree.resolution
    most = max(1, ENTRIES_PER_BLOCK // (status.shape[1] * 3 * nodes.tree.resolution**2)) if dense else DEEP_PHOTOS
    for photos in by_weights(weights):
        solvable = photos[(status[photos] == Status.CONVERGED).any(dim=1)]
        if solvable.shape[0] > 0:
            yield from solvable.split(most)


def unsolved(nodes: NodeColumns, status: Int[Tensor, "photos channels"]) -> Outcome:
    """Returns what holds for items that fail: no light, no function in use."""
    tree, device = nodes.tree, status.device
    numbers = {"dtype": torch.float64, "device": device}
    return Outcome(
        coefficients=torch.zeros(*status.shape, 3 * tree.resolution**2, **numbers),
        irradiance=torch.zeros(*status.shape, nodes.points, **numbers),
        figures=torch.full((*status.shape, FIGURES), torch.nan, **numbers),
        steps=torch.zeros_like(status),
        kept=torch.zeros(*status.shape, 3 * tree.resolution**2, dtype=torch.bool, device=device),
        fate=torch.full((*status.shape, tree.supports.shape[0]), int(Fate.UNSOLVED), dtype=torch.int8, device=device),
        regions=torch.zeros_like(status),
    )


def scaled(outcome: Outcome, scale: Float[Tensor, "photos 1 1"]) -> Outcome:
    """Returns the outcome for targets multiplied by a scale."""
    return replace(outcome, coefficients=outcome.coefficients * scale, irradiance=outcome.irradiance * scale)


def put(whole: Outcome, photos: Int[Tensor, " block"], solvable: Bool[Tensor, "block channels"], part: Outcome) -> None:
    """Writes the outcome of some photographs into that of all, in place; channels that cannot be solved stay as is."""
    photo, channel = solvable.nonzero(as_tuple=True)
    for field in fields(Outcome):
        getattr(whole, field.name)[photos[photo], channel] = getattr(part, field.name)[photo, channel]


def assembled(
    outcome: Outcome,
    samples: Float[Tensor, "*batch channels points"],
    status: Int[Tensor, "photos channels"],
    noise: Float[Tensor, " photos"],
) -> AdaptiveSolution:
    """Returns the outcome in the shape and dtype of the samples."""
    items = samples.shape[:-1]
    found = torch.cat([outcome.coefficients, outcome.figures], dim=-1)
    return AdaptiveSolution(
        solution=assemble(samples, found, status, outcome.steps),
        irradiance=outcome.irradiance.to(samples).reshape(*items, -1),
        refinement=Refinement(
            kept=outcome.kept.reshape(*items, -1),
            fate=outcome.fate.reshape(*items, -1),
            regions=outcome.regions.reshape(items),
        ),
        noise=noise.to(samples).reshape(items[:-1]),
    )
