"""Where the object stands by its silhouette, in photographs that Mitsuba renders of it standing elsewhere.

    python scripts/silhouette_check.py [--out out/silhouette_check] [--data DIR]

The scene file has the block of `torchlight target` in the middle of the printed sheet, turned by 30 degrees; in the
photographs it stands 2 mm to the right, 3 mm towards the reader and is turned by 2 degrees more, or stands as stated.
Photographs: 1600 x 1200 through a distorting lens, a block of albedo 0.05 or 0.6, 8-bit sRGB, noise of 1 % of white;
the camera's pose is found from the markers. Prints what `--refine-pose silhouette` finds, its stated deviations, and
the errors in units of these. With --data also for the cardboard cube of DIR/photos/desk_cube10cm, displaced in its
scene by more: how far from the place fitted to its corners by hand it comes back. Writes a picture of the outlines.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import torch
import tyro
from rendered.photograph import installed
from rendered.sheet import EBONY, Lamp, standing
from rendered.sheet_views import Case, block_pose
from rendered_chain import LENS, Printed, run

from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.io.images import Photo, read_photo
from torchlight.io.scene_file import load_scene
from torchlight.io.target_file import read_target
from torchlight.observing import linearize, placed
from torchlight.photo.board_camera import BoardCamera
from torchlight.photo.target import DEFAULT_PROP, Sheet
from torchlight.placement import silhouette
from torchlight.placement.report import Placement, sentence
from torchlight.shadow_fit import at

MOVED, TURNED = (2.0, -3.0), 2.0  # millimetres, degrees
CARDBOARD = 0.6
CASES = [
    (Case("lamp at 40, 50 degrees", Lamp(40.0, 50.0)), EBONY),
    (Case("lamp at 160, 38 degrees", Lamp(160.0, 38.0)), EBONY),
    (Case("lamp at 285, 65 degrees", Lamp(285.0, 65.0), azimuth_degrees=140.0), EBONY),
    (Case("lamp at 40, 50 degrees", Lamp(40.0, 50.0)), CARDBOARD),
    (Case("lamp at 220, 45 degrees", Lamp(220.0, 45.0), azimuth_degrees=20.0), CARDBOARD),
]
CUBE = Path(__file__).resolve().parents[1] / "configs" / "scenes" / "desk_cube10cm"
CUBE_MOVED, CUBE_TURNED = (6.0, -5.0), 3.0


@dataclass(frozen=True, eq=False)
class Shown:
    """One photograph, its scene and what was found.

    Attributes:
        name: in the table.
        photo: the file.
        scene: as stated, with the photograph's camera.
        true: x, y and turn by which the object is displaced, degrees.
        found: the report.
    """

    name: str
    photo: Path
    scene: Scene
    true: tuple[float, float, float]
    found: Placement


def rendered(page: Printed) -> Iterator[Shown]:
    """Yields what is found in the rendered photographs."""
    for index, (case, albedo) in enumerate(CASES):
        camera = LENS.at(block_pose(case, page.sheet))
        for displaced in (True, False):
            true = (*MOVED, TURNED) if displaced else (0.0, 0.0, 0.0)
            turn = DEFAULT_PROP.turn_degrees + true[2]
            prop = replace(DEFAULT_PROP, position=true[:2], turn_degrees=turn)
            name = f"{'displaced' if displaced else 'stated'}{index}"
            photo = page.photograph(name, camera, case, standing(prop, albedo), 4)
            scene = stated(page.sheet)
            scene = placed(scene, read_photo(photo), str(photo))
            _, found = silhouette.refine(scene, linearize(read_photo(photo), scene))
            what = "displaced" if displaced else "in its place"
            yield Shown(f"{case.name}, albedo {albedo:g}, {what}", photo, scene, true, found)


def stated(sheet: Sheet) -> Scene:
    """Returns the scene with the block where the sheet has its footprint."""
    turn = (0.0, 0.0, DEFAULT_PROP.turn_degrees)
    x, y, z = DEFAULT_PROP.size
    triangles = transform(box((x, y, z)), 1.0, turn, (0.0, 0.0, 0.0))
    width, height = sheet.inside
    receiver = Receiver((0.0, 0.0), (width, height), (int(width / 2), int(height / 2)))
    return Scene(triangles, receiver, units="mm", encoding="srgb", finder=BoardCamera(LENS, sheet))


def row(shown: Shown) -> str:
    """Returns a line of the table: found +- deviation (error in deviations), per parameter."""
    found = shown.found
    values = (*found.moved, found.turned_degrees)
    cells = []
    for value, true, spread in zip(values, shown.true, found.deviation, strict=True):
        sure = "" if spread is None else f" +- {spread:.3f} ({(value - true) / spread:+.1f})"
        cells.append(f"{value:.3f}{sure if found.changed else ''}")
    rms = "-" if found.rms_after is None else f"{found.rms_after:.2f}"
    return f"| {shown.name} | {' | '.join(cells)} | {rms} | {found.verdict.rstrip(',')} |"


def displaced_cube(data: Path) -> Iterator[str]:
    """Yields a line per photograph of the cube: what is found of it as stated, and displaced in the scene."""
    for name in ("img3", "img4"):
        scene = load_scene(CUBE / f"{name}.yaml")
        photo = linearize(read_photo(data / "photos" / "desk_cube10cm" / f"{name}.JPG"), scene)
        yield f"{name}, as stated: {sentence(silhouette.refine(scene, photo)[1], scene.units)}"
        frame = silhouette.frame_of(scene)
        pose = torch.tensor([*CUBE_MOVED, math.radians(CUBE_TURNED)], dtype=torch.float64) / frame.unit
        found = silhouette.refine(at(frame, pose), photo)[1]
        x, y = (moved + found for moved, found in zip(CUBE_MOVED, found.moved, strict=True))
        left = f"({x:.2f}, {y:.2f}) mm and {CUBE_TURNED + found.turned_degrees:.2f} degrees"
        yield f"{name}, displaced in its scene by {CUBE_MOVED} mm and {CUBE_TURNED:g} degrees: {left} are left"


def draw(shown: list[Shown], path: Path) -> None:
    """Draws the outline as stated and as found over the displaced photographs."""
    chosen = [one for one in shown if one.true[2] != 0.0]
    figure, axes = plt.subplots(1, len(chosen), figsize=(4 * len(chosen), 4.4), layout="constrained")
    for axis, one in zip(axes, chosen, strict=True):
        photo: Photo = read_photo(one.photo)
        sight = silhouette.sight_of(one.scene, linearize(photo, one.scene))
        values = torch.tensor([*one.found.moved, math.radians(one.found.turned_degrees)], dtype=torch.float64)
        before = silhouette.outline_at(sight, torch.zeros_like(values)).pixels
        after = silhouette.outline_at(sight, values / sight.frame.unit).pixels
        axis.imshow(photo.pixels.permute(1, 2, 0).clamp(0, 1))
        axis.plot(*before.T, ".", color="#56B4E9", ms=2.5, label="as stated")
        axis.plot(*after.T, ".", color="#D55E00", ms=2.5, label="as found")
        low, high = before.amin(dim=0) - 40, before.amax(dim=0) + 40
        axis.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), xlabel="column, pixels", ylabel="row, pixels")
        axis.set_title(one.name.removesuffix(", displaced"), fontsize=9)
    axes[0].legend(loc="lower left", fontsize=8)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main(out: Path = Path("out/silhouette_check"), samples: int = 16, data: Path | None = None) -> None:
    """Renders, finds and prints; photographs that are already in the folder are kept.

    Args:
        out: folder for everything.
        samples: light paths per pixel.
        data: folder that holds photos/desk_cube10cm; None = leave the cube out.
    """
    if not installed():
        sys.exit("silhouette_check: Mitsuba 3 is needed: pip install 'torchlight[mitsuba]'")
    out.mkdir(parents=True, exist_ok=True)
    run("target", "--out", out / "target.pdf", "--overwrite")
    shown = list(rendered(Printed(out, read_target(out / "target.yaml"), samples)))
    print("| photograph | x, mm | y, mm | turn, degrees | RMS, px | |\n| --- | --- | --- | --- | --- | --- |")
    print("\n".join(map(row, shown)))
    draw(shown, out / "silhouettes.png")
    print(f"pictures: {out / 'silhouettes.png'}")
    if data is not None:
        print("\n".join(displaced_cube(data)))


if __name__ == "__main__":
    tyro.cli(main)
