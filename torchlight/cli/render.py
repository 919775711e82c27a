"""`torchlight render`: a scene's receiver under a light, as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import check_writable
from torchlight.io.exr import write_exr
from torchlight.io.images import write_png
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.photo.radiometry import encode
from torchlight.results import light_is
from torchlight.view import View, render

SUFFIXES = (".exr", ".png")


@dataclass(frozen=True)
class Target:
    """Where a picture goes, and where its mask goes."""

    picture: Path
    mask: Path


def run(command: arguments.Render) -> int:
    """Writes the picture and says what its values are."""
    target = check_target(command)
    scene = load_scene(command.scene)
    light = read_light(command.light, command.convention)
    with progress_bar("casting rays") as progress:
        view = render(scene, light, command.rays, progress)
    picture = view.values * command.exposure
    if not bool(picture.isfinite().all()):
        raise ConfigError(f"{command.light} at --exposure {command.exposure:g}: values beyond float32; scale it down")
    if target.picture.suffix.lower() == ".exr":
        metadata = {"values": f"{command.exposure:g} x albedo x irradiance / pi", "light_is": light_is(scene)}
        write_exr(target.picture, picture, metadata)
        write_png(target.mask, (view.shows_plane * 255).byte().numpy())
        print(f"{target.picture}: linear, brightest {picture.max().item():.3g}; {target.mask}")
    else:
        encoding = scene.encoding if scene.encoding in ("linear", "gamma") else "srgb"
        clipped = write_display(target.picture, view, command.exposure, encoding, scene.gamma)
        print(f"{target.picture}: 8-bit {encoding}, {clipped:.1%} of the receiver's pixels clipped")
    return 0


def check_target(command: arguments.Render) -> Target:
    """Returns where to write.

    Raises:
        ConfigError: a suffix other than .exr and .png, or an exposure that is not positive.
        FormatError: the picture exists and may not be replaced.
    """
    if command.out.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"--out {command.out}: expected a name that ends in .exr or .png")
    if not 0 < command.exposure < float("inf"):
        raise ConfigError(f"--exposure: expected a positive number, got {command.exposure}")
    target = Target(command.out, command.out.with_name(f"{command.out.stem}_mask.png"))
    if not command.out.parent.is_dir():
        raise FormatError(f"{command.out}: there is no folder {command.out.parent}; make it, or choose another --out")
    check_writable(command.out.parent)
    written = (target.picture, target.mask) if command.out.suffix.lower() == ".exr" else (target.picture,)
    for path in written:
        if path.exists() and not command.overwrite:
            raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")
        if path.is_dir():
            raise FormatError(f"{path}: is a folder; choose another --out")
    return target


def write_display(path: Path, view: View, exposure: float, encoding: str, gamma: float) -> float:
    """Writes an 8-bit PNG with alpha and returns the share of the receiver's pixels that were clipped."""
    linear = view.values * exposure
    values = linear.clamp(0, 1)
    encoded = encode(values, encoding, gamma)
    alpha = view.opaque[None].to(encoded)
    image = (torch.cat([encoded, alpha]) * 255).round().byte().permute(1, 2, 0).contiguous()
    write_png(path, image.numpy())
    clipped = (linear > 1).any(dim=0) & view.shows_plane
    return (clipped.sum() / view.shows_plane.sum().clamp(min=1)).item()
