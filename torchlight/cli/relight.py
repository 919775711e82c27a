"""`torchlight relight`: a photograph under another light, or without the shadows on its plane."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.cli import arguments
from torchlight.cli.outputs import check_outputs
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError
from torchlight.insertion.relit import Bounds, Relit, filled, relight_photo, remove_shadow
from torchlight.io.images import read_photo
from torchlight.io.lights import read_light
from torchlight.io.pictures import check_suffix, storage_of, write_picture
from torchlight.io.scene_file import load_scene
from torchlight.observing import linearize, placed


def run(command: arguments.Relight) -> int:
    """Writes the picture and says where it is not to be trusted."""
    check(command)
    photo = read_photo(command.photo)
    scene = placed(load_scene(command.scene), photo, str(command.photo))
    linear = linearize(photo, scene)
    light = read_light(command.light, command.convention)
    bounds = Bounds(command.rays, command.gain)
    with progress_bar("casting rays") as progress:
        if command.from_light is None:
            made = remove_shadow(linear, scene, light, bounds, progress)
        else:
            old = read_light(command.from_light, command.convention)
            made = relight_photo(linear, scene, old, light, bounds, progress)
    storage = storage_of(photo, scene.encoding, scene.gamma, scene.response)
    metadata = {"values": f"{command.exposure:g} x linear, as the photograph"}
    clipped = write_picture(command.out, picture(command, made), storage, metadata)
    print(f"{command.out}: {said(command, made)}; {clipped:.1%} clipped")
    return 0


def check(command: arguments.Relight) -> None:
    """Raises TorchlightError where the arguments do not go together or the picture cannot be written."""
    if command.remove_shadow == (command.from_light is not None):
        raise ConfigError(
            "give either --from OLD_LIGHT, the light of the photograph, and LIGHT as the new one, or --remove-shadow "
            "and LIGHT as that of the photograph; `torchlight estimate` recovers it"
        )
    if not 0 < command.exposure < float("inf"):
        raise ConfigError(f"--exposure: expected a positive number, got {command.exposure}")
    check_suffix(command.out, transparent(command))
    check_outputs([command.out], command.overwrite)


def transparent(command: arguments.Relight) -> bool:
    """Returns whether the picture has alpha."""
    return command.remove_shadow and command.hole == "transparent"


def picture(command: arguments.Relight, made: Relit) -> Float[Tensor, "channels height width"]:
    """Returns what is stored, linear."""
    shown = made.picture * command.exposure
    if transparent(command):
        alpha = (~made.hole).to(shown)[None]
        return torch.cat([shown * alpha, alpha])
    return filled(shown, made.hole) if command.hole == "fill" else shown


def said(command: arguments.Relight, made: Relit) -> str:
    """Returns how many pixels are held, a hole, or left alone."""
    parts = [f"{share(made.held)} held at the largest gain, where the photograph tells little"]
    if command.remove_shadow:
        done = {"fill": "filled", "transparent": "transparent", "keep": "kept"}[command.hole]
        parts.append(f"{share(made.hole)} of objects {done}")
    if bool(made.unknown.any()):
        parts.append(f"{share(made.unknown)} beyond the plane left as they were")
    return ", ".join(parts)


def share(mask: Tensor) -> str:
    """Returns how many pixels a mask holds, in words."""
    return f"{int(mask.sum()):,} pixels ({mask.double().mean().item():.1%})"
