"""The lines of the table: what light is made of and how it is found. One entry of METHODS is one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.refinement import Refinement
from torchlight.light.bases import Basis, SphericalHarmonics, Texels
from torchlight.photo.observation import Observation
from torchlight.pipeline import find_light
from torchlight.precomputation import Columns
from torchlight.solvers import NNLS, NonnegativeSynthesis, Ridge, Solution, Solver
from torchlight.transfer import Transfer

from .harmonics import chosen_harmonics

SH_RESOLUTION = 32
Settings = tuple[Basis, Solver | AdaptiveHaar]


class Family(Enum):
    """What the ratios of Table 1 compare."""

    HARMONICS = "spherical harmonics"
    HAAR = "Haar wavelets"
    TEXELS = "texels"


@dataclass(frozen=True)
class Method:
    """A line of the table.

    Attributes:
        name: as printed.
        family: what it stands for in the ratios.
        resolution: of the dense transport it takes.
        choose: from the transport and the photograph to the settings; most look at neither.
        finest: resolution up to which squares are cast on demand beside the transport; None = the transport alone.
    """

    name: str
    family: Family
    resolution: int
    choose: Callable[[Transfer, Observation], Settings]
    finest: int | None = None


def fixed(name: str, family: Family, basis: Basis, solver: Solver | AdaptiveHaar) -> Method:
    """Returns a method whose settings are the same for every photograph."""
    return Method(name, family, basis.resolution, lambda _transfer, _photo: (basis, solver))


def adaptive(name: str, settings: AdaptiveHaar) -> Method:
    """Returns a line of the adaptive method."""
    dense, finest = settings.dense_resolution, settings.max_resolution
    return Method(name, Family.HAAR, dense, lambda _transfer, _photo: (settings.basis, settings), finest)


def harmonics(degree: int, solver: Solver, suffix: str = "") -> Method:
    """Returns a line of spherical harmonics."""
    name = f"SH, {(degree + 1) ** 2} coefficients{suffix}"
    return fixed(name, Family.HARMONICS, SphericalHarmonics(degree, SH_RESOLUTION), solver)


GAIN = adaptive("Haar, adaptive, by gain", AdaptiveHaar(max_resolution=16, budget=120))
CHOSEN = Method("SH, degree and damping chosen", Family.HARMONICS, SH_RESOLUTION, chosen_harmonics)
METHODS = (
    GAIN,
    adaptive("Haar, adaptive, the paper's rule", AdaptiveHaar(max_resolution=16, budget=120, rule=LevelByLevel())),
    adaptive("Haar, by gain, free to 128, at most 120", AdaptiveHaar(max_resolution=128, budget=120)),
    adaptive("Haar, by gain, free to 128, at most 450", AdaptiveHaar(max_resolution=128, budget=450)),
    adaptive("Haar, by gain, free to 512, at most 450", AdaptiveHaar(max_resolution=512, budget=450)),
    fixed("texels 16x16x5, non-negative", Family.TEXELS, Texels(16), NNLS()),
    harmonics(4, Ridge()),
    harmonics(5, Ridge()),
    harmonics(4, NonnegativeSynthesis(), ", non-negative"),
    harmonics(5, NonnegativeSynthesis(), ", non-negative"),
    CHOSEN,
)


@dataclass(frozen=True, eq=False)
class Found:
    """A light and how it was found."""

    basis: Basis
    solver: Solver | AdaptiveHaar
    solution: Solution
    refinement: Refinement | None


def find(method: Method, transfer: Transfer, columns: Columns, photo: Observation, noise: float) -> Found:
    """Returns the light that a method finds in a photograph of albedo 1.

    Args:
        method: the line of the table.
        transfer: of the photographed pose at the method's resolution.
        columns: that transport, or columns on demand beside it up to `method.finest`.
        photo: v = E / pi.
        noise: standard deviation that was added to the photograph, told to `AdaptiveHaar` alone; 0 = none.
    """
    received = Observation(photo.samples * math.pi, photo.weights)
    basis, solver = method.choose(transfer, received)
    if isinstance(solver, AdaptiveHaar) and noise > 0:
        solver = replace(solver, noise=noise)
    found = find_light(columns, basis, received, solver)
    return Found(basis, solver, found.solution, found.refinement)
