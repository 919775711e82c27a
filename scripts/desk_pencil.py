"""Six photographs of a pencil under a desk lamp: the recovered peak against the direction seen in the photograph.

    python scripts/desk_pencil.py --data DIR [--out out/desk_pencil]

DIR holds photos/desk_pencil/light/light_1.jpg to light_6.jpg and photos/desk_pencil/params.json (TORCHLIGHT_DATA is
used when --data is absent). The truth is the direction from the shadow's tip to the pencil's top: both ends of the
shadow are labelled in the photographs, and the pencil is 132.8 mm long. One setting for all six.
"""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from torch import Tensor

from torchlight.camera import Camera, pixel_directions
from torchlight.cli import arguments
from torchlight.cli import estimate as estimate_command
from torchlight.errors import TorchlightError
from torchlight.io.scene_file import load_scene

SCENES = Path(__file__).resolve().parent.parent / "configs" / "scenes" / "desk_pencil"
PENCIL_LENGTH = 132.8  # mm
RESOLUTION = 32  # the lamp is small: texels of 2.8 degrees


def main(data: Path | None = None, out: Path = Path("out/desk_pencil")) -> None:
    """Estimates the six lights and prints how far each peak is from the truth, in degrees.

    Args:
        data: folder that holds photos/desk_pencil; default: the environment variable TORCHLIGHT_DATA.
        out: folder that receives one folder per photograph; existing results are replaced.
    """
    folder = (data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))) / "photos" / "desk_pencil"
    if not (folder / "params.json").exists():
        sys.exit(f"desk_pencil: no params.json in '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    labels = json.loads((folder / "params.json").read_text())["labels"]
    angles = []
    for number in range(1, 7):
        photo, scene = folder / "light" / f"light_{number}.jpg", SCENES / f"light_{number}.yaml"
        command = arguments.Estimate(scene, (photo,), out, resolution=RESOLUTION, overwrite=True)
        if estimate_command.run(command) != 0:
            sys.exit(1)
        result = json.loads((out / photo.stem / "result.json").read_text())
        camera = load_scene(scene).camera
        if camera is None:
            sys.exit(f"desk_pencil: {scene} has no camera")
        truth = towards_top(camera, labels[photo.name])
        found = torch.tensor(result["peak_direction"], dtype=torch.float64)
        angles.append(math.degrees(torch.acos((truth @ found).clamp(-1, 1)).item()))
    print("| photograph | peak off by, degrees |\n| --- | --- |")
    for number, angle in enumerate(angles, start=1):
        print(f"| light_{number} | {angle:.2f} |")
    print(f"median {sorted(angles)[2] / 2 + sorted(angles)[3] / 2:.2f}, worst {max(angles):.2f} degrees")


def towards_top(camera: Camera, label: dict[str, list[float]]) -> Float[Tensor, "3"]:
    """Returns the unit vector from the shadow's tip to the pencil's top."""
    foot, tip = plane_point(camera, label["base_px"]), plane_point(camera, label["shadow_tip_px"])
    top = torch.stack([foot[0], foot[1], torch.tensor(PENCIL_LENGTH, dtype=torch.float64)])
    return torch.nn.functional.normalize(top - tip, dim=0)


def plane_point(camera: Camera, pixel: list[float]) -> Float[Tensor, "3"]:
    """Returns where a pixel's ray meets the plane z = 0."""
    direction = pixel_directions(camera, torch.tensor([pixel], dtype=torch.float64))[0]
    position = camera.position.double()
    return position - position[2] / direction[2] * direction


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"desk_pencil: {error}")
