"""`torchlight analyze`: what a scene's shadows can determine, before any photograph of a light is taken."""

from __future__ import annotations

import os
from pathlib import Path

from torchlight.analysis.observability import DETERMINED
from torchlight.analysis.sampling import check_bandwidth, random_rotations
from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.io.atomic import check_writable
from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute
from torchlight.report.case import View, cases, used_samples, view
from torchlight.report.folder import Settings, write_analysis

RESOLUTION = 32  # of the transport: harmonics vary within a texel, see docs/analysis.md


def run(command: arguments.Analyze) -> int:
    """Writes the analysis and prints its verdict: three lines per scene, and for all together where there are more.

    Raises:
        TorchlightError: nothing could start.
    """
    check_settings(command)
    check_place(command)
    rotations = random_rotations(command.rotations, command.seed)
    views = [prepare(path, command) for path in command.scenes]
    found = cases(views, command.bandwidth_max, rotations, command.noise)
    settings = Settings(command.noise, command.bandwidth_max, command.rotations, command.seed)
    write_analysis(command.out, found, settings, command.overwrite)
    for case in found:
        if len(found) > 1:
            print(f"{case.name}")
        print("\n".join(case.lines))
    if len(found) > 1:
        best = max(case.seen.share(case.seen.diagonal >= DETERMINED) for case in found[:-1])
        gain = found[-1].seen.share(found[-1].seen.determined) - best
        print(f"together: {gain:+.0%} of the upper hemisphere compared with the best scene alone")
    return 0


def prepare(path: Path, command: arguments.Analyze) -> View:
    """Returns a scene with its visible samples and its transport; errors name the file."""
    scene = load_scene(path)
    try:
        used_samples(scene)  # says what is wrong before rays are cast
        with progress_bar(f"transport of {path.name}") as progress:
            transfer = precompute(scene, RESOLUTION, use_cache=not command.no_cache, progress=progress)
        return view(path, scene, transfer)
    except TorchlightError as error:
        raise error if str(path) in str(error) else type(error)(f"{path}: {error}") from error


def check_settings(command: arguments.Analyze) -> None:
    """Raises ConfigError for options out of range."""
    if not command.scenes:
        raise ConfigError("no scene given; usage: torchlight analyze SCENE... --out DIR")
    try:
        check_bandwidth(command.bandwidth_max)
    except ConfigError as error:
        raise ConfigError(f"--bandwidth-max: {error}") from error
    if not 0 < command.noise < float("inf"):
        raise ConfigError(f"--noise: expected a positive share of the brightest sample, got {command.noise}")
    stems = [path.stem for path in command.scenes]
    for stem in stems:
        if stems.count(stem) > 1:
            raise ConfigError(f"several scenes are called {stem}; rename one, so that the results can tell them apart")


def check_place(command: arguments.Analyze) -> None:
    """Raises FormatError where the results would not be writable or would replace something else."""
    check_writable(command.out.parent)
    if not os.path.lexists(command.out):
        return
    if not command.overwrite:
        raise FormatError(f"{command.out}: already there; pass --overwrite to replace it, or choose another --out")
    if not (command.out / "analysis.json").is_file():
        raise FormatError(f"{command.out}: not an analysis, so --overwrite leaves it; choose another --out")
