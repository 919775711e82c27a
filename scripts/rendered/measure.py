"""The light found in a rendered photograph, and its error on poses that the photograph does not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from paper.measure import Transfers, pose_columns, relit_by_squares
from paper.methods import SH_RESOLUTION
from paper.setting import PHOTOGRAPHED, RECEIVER, used_samples
from torch import Tensor

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.interreflection import thrown_back, without
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.nodes import NodeColumns
from torchlight.io.images import read_photo
from torchlight.light.bases import SphericalHarmonics, Texels
from torchlight.light.environment import EnvironmentMap
from torchlight.observing import linearize, observe
from torchlight.photo.noise import LEAST_NOISE, noise_share
from torchlight.photo.observation import Observation
from torchlight.pipeline import Estimate, columns_for, explain, explain_robustly
from torchlight.precomputation import precompute
from torchlight.relighting import irradiance
from torchlight.solvers import NNLS, NonnegativeSynthesis
from torchlight.synthetic import block_scene, block_values, pixel_rays

from .probes import ALBEDO, BLOCK_ALBEDO, SCORED, Taken, scene

DEFAULT = "adaptive Haar, thrown-back light removed, noise measured"
TEXELS = "texels 16x16x5, non-negative, nothing removed"
TEXELS_TOO = "texels 16x16x5, non-negative, thrown-back light removed"
HARMONICS = "SH, 25 coefficients, non-negative"


class Bench:
    """What all lights share: the transports of the photographed pose and of those that are scored."""

    @cached_property
    def transfers(self) -> Transfers:
        """Transports of the scored poses."""
        return {
            (block, resolution): precompute(block_scene(block, RECEIVER), resolution)
            for block in SCORED
            for resolution in (16, SH_RESOLUTION)
        }

    @cached_property
    def columns(self) -> NodeColumns:
        """Columns of the photographed pose, cast on demand."""
        settings = AdaptiveHaar()
        found = columns_for(scene(PHOTOGRAPHED), settings.basis, settings)
        assert isinstance(found, NodeColumns)
        return found


@dataclass(frozen=True, eq=False)
class Shown:
    """A photograph's samples, with and without what the block throws back, and their noise.

    Attributes:
        photo: as photographed.
        thrown: what the block throws back, as found: a share of the samples.
        noise: standard deviation of a sample, of the brightest, as measured.
    """

    photo: Observation
    thrown: Float[Tensor, "3 points"]
    noise: float


def shown(taken: Taken) -> Shown:
    """Returns what a PNG says, by the way of every photograph."""
    here = scene(PHOTOGRAPHED)
    photo = observe(linearize(read_photo(taken.path), here), here)
    thrown = thrown_back(photo, here, precompute(here, 16), BLOCK_ALBEDO)
    return Shown(photo, thrown, noise_share(photo, RECEIVER.samples).item())


Way = Callable[[Shown, Bench], Estimate]


def _adaptive(seen: Shown, bench: Bench) -> Estimate:
    settings = AdaptiveHaar()
    rest = without(seen.photo, seen.thrown)
    return explain(rest, scene(PHOTOGRAPHED), bench.columns, settings.basis, settings)


def _adaptive_robust(seen: Shown, bench: Bench) -> Estimate:
    settings = AdaptiveHaar()
    rest = without(seen.photo, seen.thrown)
    return explain_robustly(rest, scene(PHOTOGRAPHED), bench.columns, settings.basis, settings)


def _plain_adaptive(seen: Shown, bench: Bench) -> Estimate:
    settings = AdaptiveHaar(noise=LEAST_NOISE)
    return explain(seen.photo, scene(PHOTOGRAPHED), bench.columns, settings.basis, settings)


def _texels(seen: Shown, _bench: Bench) -> Estimate:
    here = scene(PHOTOGRAPHED)
    return explain(seen.photo, here, precompute(here, 16), Texels(16), NNLS())


def _texels_too(seen: Shown, bench: Bench) -> Estimate:
    return _texels(replace(seen, photo=without(seen.photo, seen.thrown)), bench)


def _harmonics(seen: Shown, _bench: Bench) -> Estimate:
    here = scene(PHOTOGRAPHED)
    basis = SphericalHarmonics(4, SH_RESOLUTION)
    return explain(seen.photo, here, precompute(here, SH_RESOLUTION), basis, NonnegativeSynthesis())


WAYS: dict[str, Way] = {
    DEFAULT: _adaptive,
    TEXELS: _texels,
    TEXELS_TOO: _texels_too,
    HARMONICS: _harmonics,
    "the default with --robust": _adaptive_robust,
    "adaptive Haar, nothing removed, noise 0.4 of 255": _plain_adaptive,
}


@dataclass(frozen=True)
class Row:
    """One measurement: RMS of 255 of the brightest sample.

    Attributes:
        probe: the light.
        way: of `WAYS`.
        fit: on the photograph's samples as the method saw them.
        held_out: on every pose of `SCORED`.
        functions: most per channel; None where that was not chosen.
    """

    probe: str
    way: str
    fit: float
    held_out: tuple[float, ...]
    functions: int | None


def measured(probe: str, way: str, seen: Shown, truth: Sequence[Float[Tensor, "3 points"]], bench: Bench) -> Row:
    """Returns the error of one method's light on the poses of `SCORED`, whose exposed truth is given."""
    found = WAYS[way](seen, bench)
    scores = [
        metrics.rms_255(relit(block, found, bench.transfers), values, used_samples(block).float()).item()
        for block, values in zip(SCORED, truth, strict=True)
    ]
    functions = None if found.refinement is None else int(found.refinement.functions.max())
    return Row(probe, way, found.rms_255.item(), tuple(scores), functions)


def relit(block: Block, found: Estimate, transfers: Transfers) -> Float[Tensor, "3 points"]:
    """Returns v = E / pi of a pose under the light found."""
    coefficients, resolution = found.solution.coefficients, found.basis.resolution
    if found.refinement is not None:
        shown = relit_by_squares(pose_columns(block, resolution), coefficients, found.refinement)
    else:
        shown = irradiance(transfers[block, resolution].project(found.basis), coefficients)
    return shown.float() / torch.pi


def exposed_truth(environment: EnvironmentMap, exposure: float) -> list[Float[Tensor, "3 points"]]:
    """Returns the sheet in every pose of `SCORED`, exposed alike, by the exact shadow of a black block."""
    rays = pixel_rays(environment)
    return [(block_values(block, RECEIVER, rays) * (ALBEDO * exposure)).float() for block in SCORED]


def table(rows: Sequence[Row]) -> str:
    """Returns the measurements as a Markdown table."""
    heads = [f"held out {k + 1}" for k in range(len(SCORED))]
    lines = [f"| light | method | fit | {' | '.join(heads)} | functions |", "| --- " * (4 + len(heads)) + "|"]
    for row in rows:
        scores = " | ".join(f"{score:.2f}" for score in row.held_out)
        functions = "" if row.functions is None else str(row.functions)
        lines.append(f"| {row.probe} | {row.way} | {row.fit:.2f} | {scores} | {functions} |")
    return "\n".join(lines) + "\n"
