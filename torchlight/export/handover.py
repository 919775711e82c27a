"""What a target is handed: pictures, and the texts that load them; and what every such text says of the light."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchlight.light.environment import EnvironmentMap
from torchlight.light.formats import to_latlong
from torchlight.light.lamps import Lamp

AXES = "torchlight's: right-handed, Z up, the receiver at z = 0"


@dataclass(frozen=True, eq=False)
class Picture:
    """One EXR.

    Attributes:
        pixels: linear radiance, row 0 at the top.
        metadata: what its `torchlight` attribute says.
        openexr_envmap: whether it is a lat-long in OpenEXR's convention and is marked as one.
    """

    pixels: Float[Tensor, "3 rows columns"]
    metadata: Mapping[str, Any]
    openexr_envmap: bool = False


@dataclass(frozen=True, eq=False)
class Handover:
    """Files of one target by name.

    Attributes:
        pictures: EXRs.
        texts: programs and scene files.
        use: how to load them, in one line.
    """

    pictures: Mapping[str, Picture]
    texts: Mapping[str, str]
    use: str


def latlong_picture(light: EnvironmentMap, convention: str) -> Picture:
    """Returns a light as a lat-long of a named convention; exact, no resampling."""
    metadata = {"convention": convention, "units": light.units, "nonnegative": light.nonnegative}
    pixels = to_latlong(light.radiance, convention)
    return Picture(pixels, metadata, openexr_envmap=convention in ("openexr", "usd", "mitsuba"))


def nonnegative(light: EnvironmentMap) -> EnvironmentMap:
    """Returns a light without negative radiance, which no renderer takes."""
    return replace(light, radiance=light.radiance.clamp(min=0), nonnegative=True)


def near_line(light: EnvironmentMap) -> str:
    """Returns what a target cannot say of a light that stands near; empty where it is far away."""
    if light.plane is None:
        return ""
    return (
        f"This light stands {light.plane}; here it is taken as far away, as seen from there: elsewhere on the plane "
        "shadows will point another way."
    )


def header(light: EnvironmentMap, lamps: Sequence[Lamp], axes: str, strength: str) -> list[str]:
    """Returns the lines that every text begins with.

    Args:
        light: what is exported.
        lamps: taken out of it.
        axes: which way they go here.
        strength: what to change to make the light brighter.
    """
    lines = [
        axes,
        f"Radiance is linear, Rec.709 primaries, {light.units}: its unit is the user's to choose, by {strength}.",
    ]
    if lamps:
        given = "one lamp gives" if len(lamps) == 1 else f"{len(lamps)} lamps give"
        lines.append(f"What {given} is no longer in the picture; lamps.json lists them.")
    return [*lines, near_line(light)] if light.plane is not None else lines


def python_reader(
    light: EnvironmentMap, lamps: Sequence[Lamp], strength: float, convention: str, script: str, axes: str
) -> tuple[dict[str, Picture], dict[str, str]]:
    """Returns light_CONVENTION.exr and light_CONVENTION.py, a module that reads it, each by its name.

    Args:
        light: without the lamps. Negative radiance is kept.
        lamps: listed in the module.
        strength: written into the module.
        convention: of the picture.
        script: the module, with places for module, picture, header, strength and lamps.
        axes: which way they go here.
    """
    stem = f"light_{convention}"
    text = script.format(
        module=stem,
        picture=f"{stem}.exr",
        header="\n".join(header(light, lamps, axes, "STRENGTH")),
        strength=number(strength),
        lamps=lamp_tuples(lamps),
    )
    return {f"{stem}.exr": latlong_picture(light, convention)}, {f"{stem}.py": text}


def commented(lines: Sequence[str], mark: str) -> str:
    """Returns lines as comments."""
    return "".join(f"{mark} {line}\n" for line in lines)


def numbers(values: Sequence[float]) -> str:
    """Returns numbers as Python, JavaScript and USD write them, to seven digits."""
    return ", ".join(number(value) for value in values)


def number(value: float) -> str:
    """Returns one number to seven digits."""
    return f"{value:.7g}"


def diameter_degrees(lamp: Lamp) -> float:
    """Returns the angle that a lamp's disc spans, in degrees."""
    return 2 * math.degrees(lamp.radius)


def lamp_tuples(lamps: Sequence[Lamp]) -> str:
    """Returns lamps as Python writes them: (direction, irradiance facing it, diameter in degrees) each."""
    rows = [
        f"    (({numbers(it.direction)}), ({numbers(it.irradiance)}), {diameter_degrees(it):.7g}),\n" for it in lamps
    ]
    return "(\n" + "".join(rows) + ")" if rows else "()"
