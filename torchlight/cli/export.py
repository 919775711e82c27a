"""`torchlight export`: a light as other programs want it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from torchlight.cli import arguments
from torchlight.errors import ConfigError, FormatError
from torchlight.export.blender import blender
from torchlight.export.folder import LAMPS, write_export
from torchlight.export.handover import near_line
from torchlight.export.lamps_file import lamps_content
from torchlight.export.mitsuba import mitsuba
from torchlight.export.openexr import openexr
from torchlight.export.skylibs import skylibs
from torchlight.export.threejs import threejs
from torchlight.export.usd import usd
from torchlight.io.atomic import check_writable
from torchlight.io.lights import read_light
from torchlight.io.observability_file import observability_beside, read_observability
from torchlight.light.environment import EnvironmentMap, negative_share
from torchlight.light.lamps import Lamp, extract_lamps

TARGETS = {
    "blender": blender,
    "mitsuba": mitsuba,
    "openexr": openexr,
    "usd": usd,
    "threejs": threejs,
    "skylibs": skylibs,
}
KEEP_NEGATIVE = ("openexr", "skylibs")
LISTED = 4  # lamps named in lamps.json where none is asked for


def run(command: arguments.Export) -> int:
    """Writes the folder and says how each program loads it."""
    check_settings(command)
    source = light_file(command.light)
    light = read_light(source, command.convention)
    observability = known_observability(command.observability, source)
    lamps, rest = extract_lamps(light, command.lamps or LISTED)
    taken = command.lamps > 0
    shown, given = (rest, lamps) if taken else (light, ())
    handovers = {name: TARGETS[name](shown, given, command.strength) for name in dict.fromkeys(command.to)}
    content = lamps_content(light, rest, lamps, taken, observability)
    write_export(command.out, list(handovers.values()), content, command.overwrite)
    for name, handover in handovers.items():
        print(f"{name}: {', '.join([*handover.pictures, *handover.texts])}; {handover.use}")
    print(f"{command.out / LAMPS}: {lamps_line(command.lamps, lamps)}")
    for line in warnings(light, command.to):
        print(line)
    return 0


def check_settings(command: arguments.Export) -> None:
    """Raises ConfigError for options out of range, FormatError for a folder that may not be replaced."""
    if not 0 < command.strength < float("inf"):
        raise ConfigError(f"--strength: expected a positive number, got {command.strength}")
    if command.lamps < 0:
        raise ConfigError(f"--lamps: expected 0 or more, got {command.lamps}")
    check_writable(command.out.parent)
    if not os.path.lexists(command.out):
        return
    if not command.overwrite:
        raise FormatError(f"{command.out}: already there; pass --overwrite to replace it, or choose another --out")
    if not (command.out / LAMPS).is_file():
        raise FormatError(f"{command.out}: not an export, so --overwrite leaves it; choose another --out")


def light_file(path: Path) -> Path:
    """Returns the light's file: the path itself, or light.exr in the folder of an estimate."""
    return path / "light.exr" if path.is_dir() else path


def known_observability(given: Path | None, light: Path) -> Float[Tensor, "height width"] | None:
    """Returns R_ii of what was named, else of what lies beside the light, else None."""
    path = observability_beside(light.parent) if given is None else given
    return None if path is None else read_observability(path)


def lamps_line(asked: int, lamps: Sequence[Lamp]) -> str:
    """Returns what lamps.json holds, in words."""
    if not lamps:
        return "no source stands out of the light around it, so there are no lamps"
    share = f"{sum(lamp.share for lamp in lamps):.0%} of the light on the plane"
    found = "1 lamp" if len(lamps) == 1 else f"{len(lamps)} lamps"
    if asked == 0:
        return f"{found}, {share}, still in the pictures; --lamps {len(lamps)} takes them out"
    fewer = f" ({asked} asked for)" if len(lamps) < asked else ""
    return f"{found}{fewer} taken out of the pictures, {share}"


def warnings(light: EnvironmentMap, targets: tuple[str, ...]) -> list[str]:
    """Returns what targets cannot say of a light, a line each."""
    lines = [near_line(light)] if light.plane is not None else []
    clipped = [name for name in dict.fromkeys(targets) if name not in KEEP_NEGATIVE]
    if clipped and bool((light.radiance < 0).any()):
        lines.append(
            f"negative radiance was set to 0 for {', '.join(clipped)}: {float(negative_share(light)):.2%} of the flux"
        )
    return lines
