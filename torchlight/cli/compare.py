"""`torchlight compare`: how far a light is from a reference."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.io.atomic import check_writable, partial_folder, write_atomically
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.light_metrics.flip import evaluator, hdr_flip
from torchlight.light_metrics.protocol import (
    MATERIALS,
    Protocol,
    SphereTest,
    Tone,
    check_protocol,
    named_protocol,
    sphere_test,
)
from torchlight.light_metrics.spheres import picture
from torchlight.light_metrics.summary import Pair, measures, paired
from torchlight.precomputation import precompute
from torchlight.relighting import lit_by
from torchlight.report.comparison import Comparison, SceneComparison, against_scene, summary, table
from torchlight.report.comparison_picture import comparison_picture
from torchlight.results import write_json

MAX_RESOLUTION = 32  # 3,072 texels: the decomposition takes minutes beyond


def run(command: arguments.Compare) -> int:
    """Prints the table or JSON, and writes compare.json and compare.png where there is --out."""
    check(command)
    protocol = chosen_protocol(command)
    light = read_light(command.light, command.convention)
    reference = read_light(command.reference, command.reference_convention)
    pair = paired(light, reference, command.over, command.height, command.fit)
    with progress_bar("lighting spheres") as progress:
        spheres = sphere_test(pair.light, pair.reference, protocol, progress)
    found = Comparison(
        names=(str(command.light), str(command.reference)),
        heights=(light.height, reference.height),
        pair=pair,
        fit=command.fit,
        log_offset=command.log_offset,
        measures=measures(pair, command.log_offset),
        protocol=protocol,
        spheres=spheres,
        scene=None if command.scene is None else in_scene(command.scene, pair, command),
        flip=flips(pair, spheres) if command.flip else None,
    )
    result = summary(found)
    if command.out is not None:
        write(command.out, result, comparison_picture(found), command.overwrite)
    print(json.dumps(result, indent=2) if command.json else "\n".join(table(result)))
    return 0


def in_scene(path: Path, pair: Pair, command: arguments.Compare) -> SceneComparison:
    """Returns what the difference means in photographs of a scene; errors name its file."""
    scene = load_scene(path)
    try:
        scene = lit_by(scene, pair.light)
        with progress_bar(f"transport of {path.name}") as progress:
            transfer = precompute(scene, command.resolution, use_cache=not command.no_cache, progress=progress)
        with progress_bar("casting rays") as progress:
            return against_scene(pair, scene, transfer, command.noise, command.rays, progress)
    except TorchlightError as error:
        raise error if str(path) in str(error) else type(error)(f"{path}: {error}") from error


def flips(pair: Pair, spheres: SphereTest) -> dict[str, float]:
    """Returns the mean HDR-FLIP of the maps and of every material's spheres."""
    rows = pair.light.height // 2 if pair.part == "upper" else pair.light.height
    found = {"maps": hdr_flip(pair.light.radiance[:, :rows], pair.reference.radiance[:, :rows]).mean}
    for name in MATERIALS:
        shown, wanted = (picture(values[name], spheres.inside) for values in (spheres.light, spheres.reference))
        found[name] = hdr_flip(shown, wanted).mean
    return found


def chosen_protocol(command: arguments.Compare) -> Protocol:
    """Returns the named protocol with what other options replace.

    Raises:
        ConfigError: a setting out of range.
    """
    protocol = named_protocol(command.protocol)
    given: dict[str, Any] = {
        "size": command.sphere_size,
        "view": command.view,
        "clip": command.clip,
        "pixels": command.pixels,
        "per": command.per,
        "black": command.black,
    }
    protocol = replace(protocol, **{name: value for name, value in given.items() if value is not None})
    if command.tone is not None:
        protocol = replace(protocol, tone=None if command.tone == "none" else Tone())
    if command.map_height is not None:
        protocol = replace(protocol, map_height=command.map_height if command.map_height != 0 else None)
    check_protocol(protocol)
    return protocol


def check(command: arguments.Compare) -> None:
    """Raises before anything is read where an option is out of range or results could not be written."""
    if not 2 <= command.resolution <= MAX_RESOLUTION or command.resolution % 2:
        raise ConfigError(f"--resolution: expected an even number from 2 to {MAX_RESOLUTION}, got {command.resolution}")
    if not 0 < command.noise < float("inf"):
        raise ConfigError(f"--noise: expected a positive share of the brightest sample, got {command.noise}")
    if command.flip:
        evaluator()
    if command.out is None:
        return
    check_writable(command.out.parent)
    if os.path.lexists(command.out) and not command.overwrite:
        raise FormatError(f"{command.out}: already there; pass --overwrite to replace it, or choose another --out")
    if os.path.lexists(command.out) and not (command.out / "compare.json").is_file():
        raise FormatError(f"{command.out}: not a comparison, so --overwrite leaves it; choose another --out")


def write(folder: Path, result: dict[str, Any], image: bytes, overwrite: bool) -> None:
    """Writes the folder of a comparison, complete or not at all."""
    with partial_folder(folder, overwrite=overwrite) as partial:
        write_json(partial / "compare.json", result)
        write_atomically(partial / "compare.png", image)
