"""`torchlight convert`: a light as another kind of picture of the sphere, or as spherical harmonics."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchlight.cli import arguments, fail
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import check_writable, write_atomically
from torchlight.io.coefficients import write_coefficients
from torchlight.io.lights import read_stored, say_what_is_lost, write_sampled
from torchlight.light.formats import grid_as_fine, grid_for, is_latlong, to_picture
from torchlight.light.grids import CubeGrid, Grid
from torchlight.light.procedural import axis_faces
from torchlight.light.projection import check_degree
from torchlight.light.rotations import is_about_z, parse_rotation
from torchlight.light.sampled import SampledLight, converted, sphere_power, to_environment
from torchlight.preview import encode_png, preview, to_srgb8

AXES = "axes"
HARMONICS = ("sh", "irradiance-sh")
PICTURES = (".exr", ".hdr", ".png")
DEGREE = 8
MAXIMUM_SIZE = 8192
AXES_ROWS = 128


def run(command: arguments.Convert) -> int:
    """Writes the light and says what was written."""
    kind = check(command)
    light, metadata = read(command, kind)
    if kind in HARMONICS:
        light = turned(command, light, light.grid)
        degree = DEGREE if command.degree is None else command.degree
        convolved = kind == "irradiance-sh"
        write_coefficients(
            command.out, light, degree, metadata, cosine_convolved=convolved, primaries=command.primaries
        )
        said = f"spherical harmonics to degree {degree}" + (", times A_l (irradiance)" if convolved else "")
    else:
        grid = grid_as_fine(kind, light.grid) if command.size is None else grid_for(kind, command.size)
        light = turned(command, light, grid)
        said = write_picture(command, light, kind, metadata)
    power = " ".join(f"{value:.5g}" for value in sphere_power(light).tolist())
    print(f"{command.out}: {said}; power {power} (red, green, blue: integral of radiance over the sphere)")
    return 0


def check(command: arguments.Convert) -> str:
    """Returns the kind to write.

    Raises:
        ConfigError: options that contradict each other or are out of range.
        FormatError: the file exists and may not be replaced, or cannot be written.
    """
    suffix = command.out.suffix.lower()
    if suffix not in (*PICTURES, ".json"):
        raise ConfigError(f"--out {command.out}: expected a name that ends in .exr, .hdr, .png or .json")
    kind = command.to or ("sh" if suffix == ".json" else "torchlight")
    if (kind in HARMONICS) != (suffix == ".json"):
        expected = ".json" if kind in HARMONICS else ".exr, .hdr or .png"
        raise ConfigError(f"--to {kind}: is written as {expected}, not as {suffix}; change --to or the name of --out")
    if kind in HARMONICS and command.size is not None:
        raise ConfigError("--size: spherical harmonics have a --degree instead")
    if kind not in HARMONICS and command.degree is not None:
        raise ConfigError(f"--degree: {kind} has a --size instead")
    if command.size is not None and not 1 <= command.size <= MAXIMUM_SIZE:
        raise ConfigError(f"--size: expected 1 to {MAXIMUM_SIZE} pixels, got {command.size}")
    if suffix == ".png" and command.primaries != "rec709":
        raise ConfigError("--primaries: a .png is sRGB, whose primaries are rec709; leave it out")
    if command.degree is not None:
        check_degree(command.degree)
    if not 0 < command.exposure < math.inf:
        raise ConfigError(f"--exposure: expected a positive number, got {command.exposure}")
    check_place(command.out, command.overwrite)
    return kind


def check_place(path: Path, overwrite: bool) -> None:
    """Raises FormatError unless a file can be written there, and may."""
    if not path.parent.is_dir():
        raise FormatError(f"{path}: there is no folder {path.parent}; make it, or choose another --out")
    check_writable(path.parent)
    if path.exists() and not overwrite:
        raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")


def read(command: arguments.Convert, kind: str) -> tuple[SampledLight, dict[str, Any]]:
    """Returns the light, at the exposure asked for, and its metadata."""
    if command.light == AXES and not Path(AXES).exists():
        light, metadata = axes(command, kind), {}
    else:
        light, metadata = read_stored(command.light, command.from_)
    radiance = light.radiance * command.exposure
    if not bool(radiance.isfinite().all()):
        raise ConfigError(f"{command.light} at --exposure {command.exposure:g}: values beyond float32; scale it down")
    return replace(light, radiance=radiance), metadata


def axes(command: arguments.Convert, kind: str) -> SampledLight:
    """Returns the test map, so fine that the size asked for shows its edges."""
    if command.from_ is not None:
        raise ConfigError("--from: the test map is what --to says; leave it out")
    if kind in HARMONICS or command.size is None:
        return axis_faces(AXES_ROWS // 2)
    grid = grid_for(kind, command.size)
    return axis_faces(grid.resolution if isinstance(grid, CubeGrid) else grid.rows)


def turned(command: arguments.Convert, light: SampledLight, grid: Grid) -> SampledLight:
    """Returns the light on a grid, turned as asked; says so where a near light becomes a distant one."""
    rotation = None if command.rotate is None else parse_rotation(command.rotate)
    if light.plane is not None and rotation is not None and not is_about_z(rotation):
        fail(f"--rotate {command.rotate}: the light stood {light.plane}: turned so, it is taken as far away")
    with progress_bar("resampling") as progress:
        return converted(light, grid, rotation, progress)


def write_picture(command: arguments.Convert, light: SampledLight, kind: str, metadata: dict[str, Any]) -> str:
    """Writes a picture and returns what it is."""
    picture = to_picture(light.radiance, light.grid, kind)
    said = f"{f'lat-long ({kind})' if is_latlong(kind) else kind}, {picture.shape[-1]} x {picture.shape[-2]} pixels"
    if command.out.suffix.lower() != ".png":
        write_sampled(command.out, light, metadata, convention=kind, primaries=command.primaries)
        return said if command.primaries == "rec709" else f"{said}, {command.primaries}"
    say_what_is_lost(command.out, light)
    shown = preview(to_environment(light))
    write_atomically(command.out, encode_png(to_srgb8(picture * shown.scale)))
    return (
        f"{said}, 8-bit sRGB of radiance x {shown.scale:.4g}, {shown.clipped_flux:.1%} of the plane's flux above white"
    )
