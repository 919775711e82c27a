"""All settings of an estimate, as one tree: a YAML file and `--light.method texels` on a command line say the same.

    light: {method: adaptive, resolution: 128}
    adaptive: {functions: 450}
    solver: {robust: true}

`torchlight config show` prints the whole tree. Nothing heavy is imported here: `--help` answers without torch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal

from tyro.conf import arg

SWITCH = "[true|false]"  # alone it is on; false is for what a --config file switches on


@dataclass(frozen=True)
class Light:
    """What light is made of."""

    method: Annotated[Literal["texels", "haar", "adaptive", "sh"], arg(aliases=["--method", "--basis"])] = "adaptive"
    """adaptive: few Haar wavelets, as fine as the photograph tells. texels: all texels of a cube map. haar: all
    wavelets on them. sh: spherical harmonics."""
    resolution: Annotated[int | None, arg(aliases=["--resolution"])] = None
    """Texels along a cube map face's edge, a power of two; under adaptive those of the finest level, up to 512 (for a
    sun). Default: 128 under adaptive (16 with --rule paper), 32 under sh, else 16."""
    degree: Annotated[int, arg(aliases=["--degree"])] = 5
    """Largest degree of spherical harmonics, (degree + 1)^2 coefficients; with --method sh."""


@dataclass(frozen=True)
class Adaptive:
    """How --method adaptive chooses its functions."""

    functions: Annotated[int, arg(aliases=["--functions"])] = 450
    """Most Haar functions per channel."""
    rule: Annotated[Literal["gain", "paper"], arg(aliases=["--rule"])] = "gain"
    """gain: best first, by what a function explains. paper: level by level, as published."""
    noise: Annotated[float | None, arg(aliases=["--noise"])] = None
    """Standard deviation of the noise per sample, as a share of the brightest sample. Default: as measured in each
    photograph, at least 0.0016 (rounding to 8 bits)."""


@dataclass(frozen=True)
class Solver:
    """How the light is found."""

    name: Annotated[Literal["nnls", "ridge", "adam"], arg(aliases=["--solver"])] = "nnls"
    """nnls: exact, radiance nowhere negative. ridge: least squares, unconstrained. adam: projected gradients."""
    robust: Annotated[bool, arg(aliases=["--robust"], metavar=SWITCH)] = False
    """Let go of samples that no light explains, such as thin foreign shadows: five solves with Huber's weights. They
    are grey in fit.png."""


@dataclass(frozen=True)
class Checks:
    """What is asked of each photograph beside its light."""

    refine_pose: Annotated[
        Literal["shadow", "silhouette"] | None, arg(metavar="[shadow|silhouette]", aliases=["--refine-pose"])
    ] = None
    """Move and turn the occluders to where their shadow, or their outline in the picture, says they stand, photograph
    by photograph, and say by how much; a moved object has its own transport. Alone: shadow. See docs/scenes.md."""
    estimate_height: Annotated[bool, arg(aliases=["--estimate-height"], metavar=SWITCH)] = False
    """Where the near-light test finds the light near, take it as standing at the height that the test finds, and say
    so; else as far away. A known height is better stated in the scene file: light.height. See docs/near_light.md."""
    skip_near_test: Annotated[bool, arg(aliases=["--skip-near-test"], metavar=SWITCH)] = False
    """Do not ask whether the light is near. See docs/near_light.md."""


@dataclass(frozen=True)
class Compute:
    """Where and how the work is done."""

    device: Annotated[Literal["auto", "cpu", "cuda"], arg(aliases=["--device"])] = "auto"
    """Where to find shadows and to solve; auto is the GPU where there is one, for --method adaptive the CPU. See
    docs/gpu.md."""
    no_cache: Annotated[bool, arg(aliases=["--no-cache"], metavar=SWITCH)] = False
    """Neither read nor write scenes' transports on disk."""


@dataclass(frozen=True)
class Output:
    """What is written for each photograph."""

    skip_pictures: Annotated[bool, arg(aliases=["--skip-pictures"], metavar=SWITCH)] = False
    """Write the light and the numbers, but no fit.png, no refinement.png and no report.html of the photograph."""
    skip_confidence: Annotated[bool, arg(aliases=["--skip-confidence"], metavar=SWITCH)] = False
    """Do not ask how far the light can be trusted: no confidence.exr. See docs/results.md."""
    skip_report: Annotated[bool, arg(aliases=["--skip-report"], metavar=SWITCH)] = False
    """Write no report.html."""
    fill: Annotated[Literal["none", "constant", "smooth"], arg(aliases=["--fill"])] = "none"
    """What the light has where the photograph determines nothing: below the plane, and where no sample sees it. none:
    0. constant: the mean of the rest. smooth: what continues the rest. It is cosmetics; see docs/results.md."""

    @property
    def reports(self) -> bool:
        """Whether every photograph has a report.html."""
        return not (self.skip_report or self.skip_pictures)


@dataclass(frozen=True)
class Config:
    """The tree."""

    light: Light = Light()
    adaptive: Adaptive = Adaptive()
    solver: Solver = Solver()
    checks: Checks = Checks()
    compute: Compute = Compute()
    output: Output = Output()


@dataclass(frozen=True)
class Method:
    """The part of the tree that asks nothing of single photographs: what `torchlight joint` takes."""

    light: Light = Light()
    adaptive: Adaptive = Adaptive()
    solver: Solver = Solver()
    compute: Compute = Compute()


DEFAULTS, METHOD_DEFAULTS = Config(), Method()


def leaves(node: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the path ("light.method") and the value of every setting, in the tree's order."""
    for field in fields(node):
        value, path = getattr(node, field.name), f"{prefix}{field.name}"
        if is_dataclass(value):
            yield from leaves(value, f"{path}.")
        else:
            yield path, value


def as_options(config: Config) -> list[str]:
    """Returns the command-line options that say what differs from the defaults."""
    usual = dict(leaves(DEFAULTS))
    changed = {path: value for path, value in leaves(config) if value != usual[path]}
    return [word for path, value in changed.items() for word in ("--" + path.replace("_", "-"), str(value))]
