"""The exports that are checked, and what their files say when programs look directions up in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from exported import measure
from exported.programs import lookup
from exported.setting import LAMPS, shot
from torchlight.cli.export import TARGETS
from torchlight.export.folder import write_export
from torchlight.export.lamps_file import lamps_content
from torchlight.io.exr import read_exr
from torchlight.light.environment import EnvironmentMap, radiance_at
from torchlight.light.lamps import Lamp, extract_lamps

PLACES = 500


@dataclass(frozen=True, eq=False)
class Exported:
    """A light, its export, and torchlight's own rendering of the block under it.

    Attributes:
        name: what tables call it.
        light: the whole.
        lamps: that the export has beside its pictures.
        folder: of the export.
        rendering: under the whole light.
    """

    name: str
    light: EnvironmentMap
    lamps: tuple[Lamp, ...]
    folder: Path
    rendering: measure.Rendering


def exported(out: Path, lights: dict[str, EnvironmentMap], with_lamps: str) -> Iterator[Exported]:
    """Yields the exports after they have been written: every light as a picture, one also with lamps."""
    for name, light in lights.items():
        rendering = measure.under_light(light)
        yield one(out, name, light, 0, rendering)
        if name == with_lamps:
            yield one(out, f"{name}, {LAMPS} lamps", light, LAMPS, rendering)


def one(out: Path, name: str, light: EnvironmentMap, count: int, rendering: measure.Rendering) -> Exported:
    """Returns one export after it has been written."""
    lamps, rest = extract_lamps(light, count)
    folder = out / name.replace(", ", "_").replace(" ", "_")
    content = lamps_content(light, rest, lamps, count > 0, None)
    write_export(folder, [target(rest, lamps, 1.0) for target in TARGETS.values()], content, overwrite=True)
    return Exported(name, light, lamps, folder, rendering)


def shots(item: Exported, program: str) -> list[dict[str, Any]]:
    """Returns what a program is to render: the block, the empty plane, and the block under each lamp alone."""
    folder = item.folder
    alone = [
        shot(folder / f"{program}_lamp_{place}.exr", picture=False, lamps=[place])
        for place in range(1, len(item.lamps) + 1)
    ]
    return [shot(folder / f"{program}_block.exr"), shot(folder / f"{program}_empty.exr", block=False), *alone]


def directions() -> Float[Tensor, "places 3"]:
    """Returns directions all over the sphere."""
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(PLACES, 3, generator=generator, dtype=torch.float64), dim=-1)


def usd_agreement(item: Exported, python: str, out: Path) -> dict[str, Any]:
    """Returns how usd-core's places in the picture, and its lamps, agree with torchlight's."""
    towards = directions()
    found = lookup("usd", python, {"folder": str(item.folder.resolve()), "directions": towards.tolist()}, out)
    stored, _ = read_exr(found["picture"])
    u, v = torch.tensor(found["places"], dtype=torch.float64).T
    row = (v * stored.shape[1]).long().clamp(max=stored.shape[1] - 1)
    column = (u * stored.shape[2]).long() % stored.shape[2]
    expected = radiance_at(extract_lamps(item.light, len(item.lamps))[1], towards)
    same = (stored[:, row, column] == expected).all(dim=0)
    lamps = zip(found["lamps"], item.lamps, strict=True)
    return {
        "version": found["version"],
        "up": found["up"],
        "format": found["format"],
        "directions_that_find_their_pixel": f"{int(same.sum())} of {len(same)}",
        "lamps": len(found["lamps"]),
        "lamps_off_by_at_most": max(
            max(_off(a["direction"], b.direction), _off(a["irradiance"], b.irradiance)) for a, b in lamps
        ),
    }


def skylibs_agreement(item: Exported, python: str, out: Path) -> dict[str, Any]:
    """Returns how skylibs' lookups by direction and by pixel agree with torchlight's."""
    towards = directions()
    found = lookup("skylibs", python, {"folder": str(item.folder.resolve()), "directions": towards.tolist()}, out)
    rest = extract_lamps(item.light, len(item.lamps))[1]
    back = torch.tensor(found["pixel_directions"], dtype=torch.float64)
    return {
        "version": found["version"],
        "by_direction_off_by_at_most": _off(found["radiance"], radiance_at(rest, towards).T),
        "by_pixel_off_by_at_most": _off(found["pixel_radiance"], radiance_at(rest, back).T),
    }


def _off(found: Any, expected: Any) -> float:
    """Returns the largest difference."""
    first, second = torch.as_tensor(found, dtype=torch.float64), torch.as_tensor(expected, dtype=torch.float64)
    return float((first - second).abs().max())
