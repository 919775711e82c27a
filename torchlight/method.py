"""From the names in a configuration to the settings objects that are the method."""

from __future__ import annotations

import torch

from torchlight.config import Config
from torchlight.errors import ConfigError
from torchlight.inversion.adaptive import AdaptiveHaar, named_rule
from torchlight.inversion.linear import named_solver
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.solvers import Solver

DEFAULT_RESOLUTION = 16
DEFAULT_ADAPTIVE_RESOLUTION = 128
DEFAULT_HARMONICS_RESOLUTION = 32  # harmonics vary within a texel: a finer transport keeps that below 0.1 of 255


def named_method(config: Config) -> tuple[Basis, Solver | AdaptiveHaar]:
    """Returns what light is made of and how it is found.

    Raises:
        ConfigError: a setting is out of range, or contradicts another.
    """
    if config.light.method == "adaptive":
        solver = adaptive_method(config)
        return solver.basis, solver
    basis = named_basis(config)
    return basis, named_solver(config.solver.name, basis)


def adaptive_method(config: Config) -> AdaptiveHaar:
    """Returns the adaptive method that a configuration describes.

    Raises:
        ConfigError: a setting is out of range, or another solver than "nnls" is asked for.
    """
    if config.solver.name != "nnls":
        raise ConfigError(
            f"--solver {config.solver.name}: --method adaptive has a solver of its own; leave --solver away"
        )
    usual = DEFAULT_ADAPTIVE_RESOLUTION if config.adaptive.rule == "gain" else DEFAULT_RESOLUTION
    resolution = usual if config.light.resolution is None else config.light.resolution
    adaptive = config.adaptive
    return AdaptiveHaar(resolution, adaptive.functions, adaptive.noise, named_rule(adaptive.rule))


def named_basis(config: Config) -> Basis:
    """Returns the basis that a configuration names."""
    resolution = config.light.resolution
    if config.light.method == "sh":
        return SphericalHarmonics(
            config.light.degree, DEFAULT_HARMONICS_RESOLUTION if resolution is None else resolution
        )
    resolution = DEFAULT_RESOLUTION if resolution is None else resolution
    return Texels(resolution) if config.light.method == "texels" else HaarCubemap(resolution)


def named_device(name: str, solver: Solver | AdaptiveHaar | None = None) -> torch.device:
    """Returns the device that a name stands for; "auto" is the GPU where there is one, for whole bases.

    The adaptive method goes there only when told to: its compiled code on a CPU is known to be fast.

    Raises:
        ConfigError: "cuda" without a usable GPU.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: this torch finds no GPU; use --device auto or cpu")
    wanted = name == "cuda" or (name == "auto" and not isinstance(solver, AdaptiveHaar))
    return torch.device("cuda" if wanted and torch.cuda.is_available() else "cpu")
