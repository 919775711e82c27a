"""From print to light, by torchlight's own commands, on photographs that Mitsuba renders of the printed sheet.

    python scripts/rendered_chain.py [--paper A3] [--out out/rendered_chain]

`torchlight target` prints, twelve photographs of the bare sheet through a distorting lens go to `torchlight calibrate`,
and `torchlight estimate` finds the lamps from photographs of the block. Photographs: 1600 x 1200, 8-bit sRGB, noise of
1 % of white. Prints tables: how far off the pose at 1 m is with the true lens, the camera, and the lamps; and the
same under shadows on markers, hidden markers, a turned sheet and an underexposed photograph.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Literal

import torch
import tyro
from jaxtyping import Float
from rendered.photograph import installed, stored
from rendered.sheet import PAPER, picture, printed, standing
from rendered.sheet_views import BARE, Case, block_pose, calibration_poses, cases, poses_at_a_metre
from torch import Tensor

from torchlight.camera import Camera, Lens, project
from torchlight.cli import main as command_line
from torchlight.io.cameras import read_lens
from torchlight.io.images import read_photo, write_png
from torchlight.io.target_file import read_target
from torchlight.photo.boards import detect, grey_picture
from torchlight.photo.pose import locate
from torchlight.photo.target import DEFAULT_PROP, Sheet, shadow_reach

LENS = Lens(
    torch.tensor([[1450.0, 0, 801.3], [0, 1455.0, 597.1], [0, 0, 1]], dtype=torch.float64),
    (1600, 1200),
    torch.tensor([0.08, -0.21, 0.0011, -0.0007, 0.05], dtype=torch.float64),
)
WRONG = 2.0  # pixels: a corner that lies farther from where the true camera has it is called wrong
SCENE = """units: mm
occluders:
  - box: [30, 20, 35]
    rotation_degrees: [0, 0, 30]
receiver: {{size: [{0:g}, {1:g}], samples: [{2:.0f}, {3:.0f}]}}
camera: {{intrinsics: camera.json, board: target.yaml}}
photo: {{encoding: srgb}}
"""


def torchlight(*words: object) -> int:
    """Runs `torchlight WORDS` and returns its exit code."""
    try:
        command_line([str(word) for word in words])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def run(*words: object) -> None:
    """Runs `torchlight WORDS`; ends the script where that fails."""
    if torchlight(*words) != 0:
        sys.exit(f"rendered_chain: torchlight {' '.join(map(str, words))} failed")


@dataclass(frozen=True)
class Printed:
    """The sheet as `torchlight target` left it, and who renders it.

    Attributes:
        folder: of target.png and target.yaml.
        sheet: what target.yaml says.
        samples: light paths per pixel.
    """

    folder: Path
    sheet: Sheet
    samples: int

    def photograph(self, name: str, camera: Camera, case: Case, objects: dict[str, Any], depth: int) -> Path:
        """Returns the 8-bit photograph of the sheet and the objects on it, rendered unless it is there."""
        path = self.folder / f"{name}.png"
        if not path.exists():
            everything = {**printed(self.folder / "target.png", self.sheet), **objects}
            light = picture(everything, camera, self.sheet, case.lamp, self.samples, depth)
            write_png(path, stored(light, case.white / (PAPER * (1 + case.lamp.ambient)), case.noise, seed=len(name)))
        return path


def off(found: Float[Tensor, "4 4"], true: Float[Tensor, "4 4"]) -> tuple[float, float]:
    """Returns how far off a pose is: the sheet's origin in camera axes, and the rotation in degrees."""
    turn = found[:3, :3] @ true[:3, :3].T
    sine = (turn - turn.T).norm().item() / (2 * math.sqrt(2))
    return (found[:3, 3] - true[:3, 3]).norm().item(), math.degrees(math.asin(min(1.0, sine)))


@dataclass(frozen=True)
class Seen:
    """What the markers of one photograph told.

    Attributes:
        markers: read.
        wrong: corners in use farther than WRONG from the truth.
        rms: of the fit, in pixels.
        origin: error in millimetres.
        turn: error in degrees.
    """

    markers: int
    wrong: int
    rms: float
    origin: float
    turn: float


def look(photo: Path, sheet: Sheet, lens: Lens, true: Camera) -> Seen:
    """Returns the pose of a photograph against the true one."""
    view = detect(sheet, grey_picture(read_photo(photo).pixels), photo.name)
    pose = locate(view, lens)
    distance = (project(true, view.points) - view.pixels).norm(dim=-1)
    origin, turn = off(pose.world_to_camera, true.world_to_camera)
    return Seen(len(view.points) // 4, int((distance[pose.used] > WRONG).sum()), pose.rms, origin, turn)


def at_a_metre(page: Printed) -> list[Seen]:
    """Returns the poses of the bare sheet at 1 m under the true lens."""
    case = Case("", BARE)
    cameras = [LENS.at(pose) for pose in poses_at_a_metre()]
    photos = [page.photograph(f"metre{k}", camera, case, {}, 2) for k, camera in enumerate(cameras)]
    return [look(photo, page.sheet, LENS, camera) for photo, camera in zip(photos, cameras, strict=True)]


def calibrated(page: Printed) -> Lens:
    """Returns what `torchlight calibrate` finds from the twelve photographs."""
    case = Case("", BARE)
    poses = calibration_poses(page.sheet)
    photos = [page.photograph(f"calibration{k}", LENS.at(pose), case, {}, 2) for k, pose in enumerate(poses)]
    target, camera = page.folder / "target.yaml", page.folder / "camera.json"
    run("calibrate", *photos, "--target", target, "--out", camera, "--overwrite")
    return read_lens(camera)


def estimated(page: Printed, case: Case, index: int, lens: Lens) -> tuple[Seen, float]:
    """Returns the pose under the calibrated lens, and how far `torchlight estimate` is off the lamp in degrees."""
    camera = LENS.at(block_pose(case, page.sheet))
    photo = page.photograph(f"block{index}", camera, case, {**standing(DEFAULT_PROP), **case.hidden}, 4)
    run("estimate", page.folder / "scene.yaml", photo, "--out", page.folder / "light", "--overwrite")
    result = json.loads((page.folder / "light" / photo.stem / "result.json").read_text())
    found, true = torch.tensor(result["peak_direction"]).double(), torch.from_numpy(case.lamp.direction)
    sine, cosine = torch.linalg.cross(found, true).norm().item(), (found @ true).item()
    return look(photo, page.sheet, lens, camera), math.degrees(math.atan2(sine, cosine))


def main(
    paper: Literal["A4", "A3", "letter"] = "A4", out: Path = Path("out/rendered_chain"), samples: int = 16
) -> None:
    """Renders, runs the commands and prints the tables; photographs that are already in the folder are kept.

    Args:
        paper: the page.
        out: folder for everything.
        samples: light paths per pixel.
    """
    if not installed():
        sys.exit("rendered_chain: Mitsuba 3 is needed: pip install 'torchlight[mitsuba]'")
    folder = out / paper
    folder.mkdir(parents=True, exist_ok=True)
    run("target", "--paper", paper, "--out", folder / "target.pdf", "--overwrite")
    page = Printed(folder, read_target(folder / "target.yaml"), samples)
    width, height = page.sheet.inside
    (folder / "scene.yaml").write_text(SCENE.format(width, height, width / 2, height / 2))
    metre = at_a_metre(page)
    lens = calibrated(page)
    listed = cases(page.sheet)
    lights = [estimated(page, case, index, lens) for index, case in enumerate(listed)]
    lowest = shadow_reach(page.sheet, DEFAULT_PROP).inside_degrees
    print(report(metre, lens, [named(case, lowest) for case in listed], lights))


def named(case: Case, lowest: float) -> str:
    """Returns a photograph's name, with a note where its light is so low that the shadow's end may not be seen."""
    return case.name if case.lamp.elevation_degrees > lowest else f"{case.name}: below {lowest:.1f}, its height is open"


def report(metre: list[Seen], lens: Lens, names: list[str], lights: list[tuple[Seen, float]]) -> str:
    """Returns the tables."""
    four = [k[[0, 1, 0, 1], [0, 1, 2, 2]] for k in (lens.intrinsics, LENS.intrinsics)]
    percent = ", ".join(f"{100 * value:+.3f}" for value in (four[0] / four[1] - 1).tolist())
    origin, turn = [seen.origin for seen in metre], [seen.turn for seen in metre]
    lines = [
        f"{len(metre)} views of the bare sheet at 1 m, true lens: origin off by {median(origin):.3f} mm (median), "
        f"{max(origin):.3f} (worst); rotation by {median(turn):.4f} degrees (median), {max(turn):.4f} (worst); "
        f"rms {min(seen.rms for seen in metre):.3f} to {max(seen.rms for seen in metre):.3f} px, "
        f"at least {min(seen.markers for seen in metre)} markers",
        f"calibrated: fx, fy, cx, cy off by {percent} %",
        "",
        "| photograph | markers read | corners wrong | rms, px | origin, mm | rotation, degrees | peak off, degrees |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, (seen, peak) in zip(names, lights, strict=True):
        pose = f"{seen.rms:.3f} | {seen.origin:.2f} | {seen.turn:.3f}"
        lines.append(f"| {name} | {seen.markers} | {seen.wrong} | {pose} | {peak:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    tyro.cli(main)
