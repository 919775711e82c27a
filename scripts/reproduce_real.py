"""Every real photograph: cameras, brackets, a pencil, a cube and a chair; one table and one page of pictures.

    python scripts/reproduce_real.py --data DIR [--out out/real]

DIR holds calib/, brackets/ and photos/ (TORCHLIGHT_DATA is used when --data is absent). Light is recovered by the
default method at its default settings everywhere. Prints the table and writes OUT/real.md and OUT/real.html, which
holds its pictures: for each case the photograph, the rectified plane, the prediction, the residual and the light.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
import tyro
from calibration_check import DESK, four, seen
from merge_check import exposure_list, log_errors
from real.chair import SCREEN, chair
from real.cube import cube, measured_lamp_height, photo_of, predicted_overlap, told_by_the_left
from real.page import Picture, Row, page, table
from real.pencil import one_lamp, pencils, second_lamp
from real.pictures import pictures_side_by_side, sheet_picture
from real.sheets import chair_sheet, cube_sheet, pencil_sheet, screen_pictures

from torchlight.calibration import Calibration, calibrate, without_outliers
from torchlight.cli import arguments, merge
from torchlight.errors import FormatError, TorchlightError
from torchlight.io.atomic import write_atomically
from torchlight.io.cameras import read_lens
from torchlight.io.images import read_photo
from torchlight.near_light.triangulation import Lamp
from torchlight.near_light.verdict import NearLight, near_light
from torchlight.photo.boards import Charuco, Chessboard, detect, grey_picture
from torchlight.photo.pose import locate
from torchlight.report.calibration_picture import calibration_picture

Item = Row | Picture
DESKTOP = [1, 1 / 2, 1 / 4, 1 / 8, 1 / 15, 1 / 30, 1 / 60, 1 / 125, 1 / 250, 1 / 500, 1 / 1000, 1 / 1600, 1 / 3200,
           1 / 6400, 1 / 8000]  # fmt: skip
LAMP = 486.2  # mm, published height of the lamp of desk_pencil
SHARES = (0.3, 0.4, 0.5, 0.6, 0.7)


def main(data: Path | None = None, out: Path = Path("out/real")) -> None:
    """Measures everything and writes the table and the page.

    Args:
        data: folder that holds calib, brackets and photos; default: the environment variable TORCHLIGHT_DATA.
        out: folder that receives real.md, real.html and the merged brackets.
    """
    folder = data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))
    missing = [name for name in ("calib", "brackets", "photos") if not (folder / name).is_dir()]
    if missing:
        raise FormatError(f"no {', '.join(missing)} in '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    out.mkdir(parents=True, exist_ok=True)
    items = list(measured(folder, out))
    rows = [item for item in items if isinstance(item, Row)]
    pictures = [item for item in items if isinstance(item, Picture)]
    print(table(rows))
    write_atomically(out / "real.md", (table(rows) + "\n").encode())
    write_atomically(out / "real.html", page(rows, pictures).encode())
    print(f"pictures: {out / 'real.html'}")


def measured(data: Path, out: Path) -> Iterator[Item]:
    """Yields the rows and the pictures of all cases, in the order in which they are shown."""
    yield from cameras(data)
    yield from brackets(data, out)
    yield from pencil(data)
    yield from half_cube(data)
    yield from near_chair(data)


def cameras(data: Path) -> Iterator[Item]:
    """Yields calibrations against the published cameras, and the pose of the ChArUco photograph."""
    folder = data / "calib" / "opencv_chessboard"
    published = four(read_lens(folder / "left_intrinsics.yml"))
    left = calibrate(seen(sorted(folder.glob("left*.jpg")), Chessboard(9, 6, 25.0, 11)))
    yield camera_row("OpenCV's chessboards, left, as published", left, published, 0.5, 0.41)
    boards = sorted((data / "photos" / "desk_pencil" / "calib").glob("*.jpg"))
    desk = without_outliers(seen(boards, Chessboard(9, 6, 28.0)))
    yield camera_row("desk_pencil, chessboards", desk, DESK, 0.3, 0.60)
    caption = "What of the frame the chessboards of desk_pencil cover, their residuals, and each photograph's error."
    yield Picture("Calibration", caption, calibration_picture(desk))
    folder = data / "calib" / "opencv_charuco"
    grey = grey_picture(read_photo(folder / "choriginal.jpg").pixels)
    view = detect(Charuco(5, 7, 40.0, 20.0, "DICT_6X6_250"), grey, "choriginal.jpg")
    rms = locate(view, read_lens(folder / "tutorial_camera_charuco.yml")).rms
    yield Row("OpenCV's ChArUco photograph, pose", "rms < 1 px", f"rms {rms:.2f} px", rms < 1)


def camera_row(what: str, found: Calibration, published: torch.Tensor, percent: float, rms: float) -> Row:
    """Returns how far fx, fy, cx and cy are off the published ones."""
    off = 100 * (four(found.lens) / published - 1).abs()
    values = ", ".join(f"{value:.2f}" for value in off.tolist())
    asked = f"published K within {percent:g} %, rms <= {rms:.2f} px"
    met = bool((off <= percent).all()) and found.rms <= rms
    return Row(what, asked, f"fx, fy, cx, cy off by {values} %; rms {found.rms:.3f} px", met)


def brackets(data: Path, out: Path) -> Iterator[Item]:
    """Yields Debevec's brackets merged against his radiance map, and a desk merged by its EXIF."""
    folder = data / "brackets" / "memorial"
    names, times = exposure_list(folder / "image_list.txt")
    church = out / "memorial.exr"
    stated = ",".join(repr(time) for time in times)
    files = tuple(folder / name for name in names)
    merge.run(arguments.Merge(files, church, response="estimate", times=stated, overwrite=True))
    found = read_photo(church).pixels
    errors = [error.median().item() for error in log_errors(found, read_photo(folder / "memorial.hdr").pixels)]
    asked = "median error of ln radiance <= 0.12 per channel"
    yield Row("memorial, 16 exposures", asked, ", ".join(f"{error:.3f}" for error in errors), max(errors) <= 0.12)
    files = tuple(sorted((data / "brackets" / "desktop01").glob("*.jpg")))
    recorded = [read_photo(file).exif.time or 0.0 for file in files]
    same = len(recorded) == len(DESKTOP) and all(
        abs(one / other - 1) < 0.01 for one, other in zip(recorded, DESKTOP, strict=True)
    )
    yield Row("desktop01, exposure times by EXIF", "1 s to 1/8000 s, 15 files", f"{len(files)} files, all read", same)
    desk = out / "desktop01.exr"
    merge.run(arguments.Merge(files, desk, response="estimate", overwrite=True))
    shown = [("memorial", toned(found)), ("desktop01", toned(read_photo(desk).pixels))]
    caption = "Merged brackets, the logarithm of radiance: window and wall in one picture."
    yield Picture("Brackets", caption, pictures_side_by_side(shown, "merged exposure brackets"))


def toned(radiance: torch.Tensor) -> np.ndarray:
    """Returns the logarithm of radiance, black at its 2 % and white at its 99.9 %, as an 8-bit picture."""
    small = radiance[:, ::2, ::2].clamp(min=1e-12).log()
    low, high = small.flatten().quantile(torch.tensor([0.02, 0.999]))
    code = ((small - low) / (high - low)).clamp(0, 1)
    return (code * 255).round().byte().permute(1, 2, 0).numpy()


def pencil(data: Path) -> Iterator[Item]:
    """Yields the peaks of the six photographs of a pencil, and the second lamp."""
    found = list(pencils(data))
    angles = sorted(each.off_degrees for each in found)
    median = (angles[2] + angles[3]) / 2
    said = f"median {median:.2f}, worst {angles[-1]:.2f} degrees"
    asked = "median <= 2, worst <= 4 degrees off"
    yield Row("desk_pencil, six peaks, one setting", asked, said, median <= 2 and angles[-1] <= 4)
    azimuth, whole = second_lamp(found)
    what = "desk_pencil, faint second lamp, light_1 and light_2"
    yield Row(f"{what}: azimuth", "within 8 degrees", f"{azimuth:.1f} degrees apart", azimuth <= 8)
    elsewhere = f"{whole:.1f} degrees apart: the shadow's tip is out of the frame, so that no height is told"
    yield Row(f"{what}: whole direction", "within 8 degrees", elsewhere, whole <= 8)
    yield lamp_row(one_lamp(found))
    yield near_row("desk_pencil, the lamp", [near_light(each.scene, each.found.observation) for each in found], LAMP)
    for each in found:
        caption = "A hard shadow of the lamp; light_1 and light_2 also hold a faint one that leaves the frame."
        yield Picture(f"desk_pencil, {each.name}", caption, sheet_picture(pencil_sheet(each)))


def half_cube(data: Path) -> Iterator[Item]:
    """Yields the cube's shadow predicted from its left half: by distant light, and by light at two heights.

    One is what the near-light test finds in the same left half, the other is measured in another photograph.
    """
    height, told = measured_lamp_height(data), told_by_the_left(data)
    what = "desk_cube10cm, right half of the shadow predicted from the left"
    kinds: list[tuple[str, float | None]] = [("distant light", None)]
    if told is not None and told.flagged:
        kinds.append((f"lamps at {told.height:.0f} mm, found in the left half", told.height))
    kinds.append((f"lamps at {height:.0f} mm, measured in img3", height))
    for kind, lamps in kinds:
        half = cube(data, lamps)
        share = predicted_overlap(half)
        others = ", ".join(f"{predicted_overlap(half, at):.2f}" for at in SHARES)
        said = f"IoU {share:.3f} (threshold at {SHARES[0]} to {SHARES[-1]}: {others})"
        yield Row(f"{what}: {kind}", "IoU >= 0.85", said, share >= 0.85)
        sheet = cube_sheet(half, photo_of(data, "img4"), f"desk_cube10cm, img4, {kind}: IoU {share:.3f}")
        caption = (
            "Fitted left of the axis alone. Observed: right of it as photographed. Grey: hidden by the cube, or the "
            "shadow of a stick."
        )
        yield Picture(f"desk_cube10cm, {kind}", caption, sheet_picture(sheet))


def near_chair(data: Path) -> Iterator[Item]:
    """Yields the chair before a screen, by distant light and by light on the screen's plane."""
    what = "periscopy_chair, RMS of 255 on the wall"
    for kind, lamps in (("distant light", None), (f"lights at {SCREEN:.0f} mm, the screen", SCREEN)):
        found = chair(data, lamps)
        rms = found.found.rms_255.item()
        yield Row(f"{what}: {kind}", "-", f"{rms:.1f}", None)
        if lamps is None:
            yield near_row("periscopy_chair, the screen", [near_light(found.scene, found.shown)], SCREEN)
        title = f"periscopy_chair, {kind}: RMS {rms:.1f} of 255"
        caption = "A wall behind a chair, lit by a computer screen 1.03 m away."
        yield Picture(f"periscopy_chair, {kind}", caption, sheet_picture(chair_sheet(found, title)))
        if lamps is not None:
            caption = "Right: the recovered light per area of the screen, from the wall and the chair's geometry alone."
            shown = pictures_side_by_side(screen_pictures(found), "what the screen showed")
            yield Picture("periscopy_chair, the screen", caption, shown)


def lamp_row(lamp: Lamp) -> Row:
    """Returns whether the directions of all photographs together say that the lamp is near, and where it is."""
    x, y, height = lamp.position.tolist()
    said = f"{'near' if lamp.flagged else 'not told'}, p = {lamp.p_value:.1g}; at ({x:.0f}, {y:.0f}, {height:.0f}) mm"
    asked = f"flagged as near; published height {LAMP:.0f} mm"
    return Row("desk_pencil, six directions together", asked, said, lamp.flagged)


def near_row(what: str, verdicts: Sequence[NearLight | None], published: float) -> Row:
    """Returns how many photographs are flagged as lit by a near lamp, and how high each says that it hangs."""
    flagged = [verdict is not None and verdict.flagged for verdict in verdicts]
    heights = ", ".join("-" if verdict is None else f"{verdict.height:.0f}" for verdict in verdicts)
    said = f"{sum(flagged)} of {len(flagged)} flagged; heights {heights} mm"
    return Row(f"{what}: near", f"flagged as near; published height {published:.0f} mm", said, all(flagged))


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"reproduce_real: {error}")
