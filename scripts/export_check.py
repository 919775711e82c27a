"""Exports light, renders a block on a plane with it in other programs, and compares with torchlight's own rendering.

    python scripts/export_check.py [--out out/export] [--light light.exr] [--samples 256] [--picture FILE.png]
        [--blender PYTHON] [--mitsuba PYTHON] [--usd PYTHON] [--skylibs PYTHON]
        [--three node_modules/three] [--browser chromium]

PYTHON is a Python that can import bpy, mitsuba, pxr or envmap; by default this one. What is absent is said and left
out. Two lights are exported as pictures, the axis-coloured map and a light recovered from the demo's photograph (or
--light), and the recovered one also as a picture with three lamps. Writes table.md, table.json and the renderings.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
from exported import measure, pictures
from exported.exports import Exported, exported, shots, skylibs_agreement, usd_agreement
from exported.programs import AbsentError, render, render_in_browser, square
from exported.setting import job
from torch import Tensor

from torchlight.demo import run_demo
from torchlight.io.atomic import make_folder, write_atomically
from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light.procedural import axis_colours, sun_and_window

AXES, RECOVERED = "axes", "recovered"
TITLES = {"blender": "Blender", "mitsuba": "Mitsuba", "threejs": "three.js"}
HEADER = """| light | program | shadows turned, degrees | irradiance off, % | left, % of the mean |
| --- | --- | ---: | ---: | ---: |"""


@dataclass(frozen=True)
class Row:
    """One program under one light: what `measure.Agreement` says, irradiance in percent."""

    light: str
    program: str
    degrees: float
    irradiance_percent: float
    rms_percent: float

    def __str__(self) -> str:
        figures = f"{self.degrees:.2f} | {self.irradiance_percent:.2f} | {self.rms_percent:.1f}"
        return f"| {self.light} | {TITLES[self.program]} | {figures} |"


@dataclass(frozen=True)
class Programs:
    """Where the programs are."""

    blender: str = sys.executable
    """Python with bpy."""
    mitsuba: str = sys.executable
    """Python with mitsuba."""
    usd: str = sys.executable
    """Python with usd-core."""
    skylibs: str = sys.executable
    """Python with skylibs."""
    three: Path = Path("node_modules/three")
    """three.js as npm installs it."""
    browser: str = "chromium"
    """Command of Chromium."""


def main(
    programs: Annotated[Programs, tyro.conf.arg(name="")],
    out: Path = Path("out/export"),
    light: Path | None = None,
    samples: int = 256,
    picture: Path | None = None,
) -> None:
    """Prints and writes the table.

    Args:
        programs: where they are.
        out: folder of exports, renderings and the table.
        light: recovered before; default: recovered now from the demo's photograph.
        samples: light paths per pixel in Blender and Mitsuba.
        picture: PNG to write the comparison to.
    """
    make_folder(out)
    found = recovered(out) if light is None else read_light(light)
    lights = {AXES: axis_colours(128, dtype=torch.float32), RECOVERED: found}
    items = list(exported(out, lights, with_lamps=RECOVERED))
    for item in items[:2]:
        print(f"{item.name}: turns of 1 degree about x, y, z are measured as {figures(item)}")
    rows, versions = [], {}
    for program in TITLES:
        with said_if_absent(program):
            for item in items:
                versions[program] = rendered(program, job(item.folder, shots(item, program), samples), programs, out)
                rows += list(compared(item, program))
    looked = {}
    for program, look in {"usd": usd_agreement, "skylibs": skylibs_agreement}.items():
        with said_if_absent(program):
            looked[program] = look(items[-1], getattr(programs, program), out)
            print(f"{program}: {json.dumps(looked[program])}")
    report(out, rows, {"versions": versions, "lookups": looked})
    if picture is not None:
        write_atomically(picture, drawn(items, rows, list(versions)))


def figures(item: Exported) -> str:
    """Returns what the measure itself makes of known turns, in degrees."""
    return ", ".join(f"{value:.2f}" for value in measure.own_error(item.light, item.rendering))


@contextmanager
def said_if_absent(program: str) -> Iterator[None]:
    """Prints that a program is not installed, and goes on."""
    try:
        yield
    except AbsentError as absent:
        print(f"{program}: left out: {absent}")


def recovered(out: Path) -> EnvironmentMap:
    """Returns the light found in the demo's photograph; kept in the folder."""
    path = out / "demo" / "light.exr"
    if not path.is_file():
        run_demo(path.parent, sun_and_window())
    return read_light(path)


def rendered(program: str, told: dict[str, Any], programs: Programs, out: Path) -> str:
    """Returns the program's version after it has written the pictures of a job."""
    if program != "threejs":
        return render(program, getattr(programs, program), told, out)
    found = render_in_browser(programs.browser, programs.three, told)
    exact = irradiance(read_light(Path(told["folder"]) / "light_threejs.exr")).double()
    drawn_sky = torch.tensor(found["sky_irradiance"], dtype=torch.float64) / exact - 1
    own = square(found["own"], told["pixels"]).double().mean(dim=(1, 2)) * math.pi / exact - 1
    print(
        f"three.js: irradiance of the sky as drawn is off by {in_percent(drawn_sky)} %, three.js' own environment "
        f"lighting by {in_percent(own)} %; Z up against Y up {found['up']}"
    )
    return f"r{found['version']}"


def in_percent(values: Tensor) -> str:
    """Returns numbers in percent."""
    return ", ".join(f"{100 * float(value):+.2f}" for value in values)


def compared(item: Exported, program: str) -> Iterator[Row]:
    """Yields the agreement of a program's pictures: under all light, and under each lamp."""
    folder = item.folder
    whole = measure.agreement(measure.plane(folder / f"{program}_block.exr"), item.rendering)
    off = max(measure.brightness_error(folder / f"{program}_empty.exr", item.light), whole.gain)
    yield Row(item.name, program, whole.degrees, 100 * off, whole.rms_percent)
    for place, lamp in enumerate(item.lamps, start=1):
        rendering = measure.under_lamp(lamp, hard=program == "threejs")
        alone = measure.agreement(measure.plane(folder / f"{program}_lamp_{place}.exr"), rendering)
        yield Row(f"{item.name}: {place} alone", program, alone.degrees, 100 * alone.gain, alone.rms_percent)


def report(out: Path, rows: Sequence[Row], content: dict[str, Any]) -> None:
    """Prints the table and writes it with versions and look-ups."""
    table = "\n".join([HEADER, *(str(row) for row in sorted(rows, key=lambda row: row.light))])
    print(table)
    write_atomically(out / "table.md", f"{table}\n".encode())
    whole = {**content, "rows": [asdict(row) for row in rows]}
    write_atomically(out / "table.json", json.dumps(whole, indent=2).encode())


def drawn(items: Sequence[Exported], rows: Sequence[Row], programs: Sequence[str]) -> bytes:
    """Returns the pictures of all programs side by side, torchlight's first."""
    planes: dict[str, list[Tensor]] = {}
    for item in items:
        shown = [measure.plane(item.folder / f"{program}_block.exr") for program in programs]
        planes[item.name] = [item.rendering.values, *shown]
    captions = {
        f"{row.light}/{TITLES[row.program]}": f"{row.degrees:.2f}°, {row.irradiance_percent:.1f} %" for row in rows
    }
    return pictures.comparison(["torchlight", *(TITLES[program] for program in programs)], planes, captions)


if __name__ == "__main__":
    tyro.cli(main)
