"""`torchlight calibrate`: a camera from photographs of a board."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torchlight.calibration import PARAMETERS, Calibration, Rejected, calibrate, rough_start, without_outliers
from torchlight.cli import arguments, fail
from torchlight.errors import CalibrationError, ConfigError, FormatError, TorchlightError
from torchlight.io.atomic import check_writable, write_atomically
from torchlight.io.cameras import write_camera, writer_for
from torchlight.io.exif import Exif
from torchlight.io.images import read_photo
from torchlight.io.target_file import read_target
from torchlight.photo.boards import Board, BoardView, Charuco, Chessboard, detect, grey_picture
from torchlight.photo.target import RULER_LENGTH, Sheet, check_ruler
from torchlight.report.calibration_picture import calibration_picture


def run(command: arguments.Calibrate) -> int:
    """Writes the camera and a picture of the evidence, and prints the evidence; 1 where photographs were left out."""
    board = named_board(command)
    picture = check_places(command)
    views, exifs, unseen = look(command.photos, board)
    result = solve(command, views, exifs)
    result = replace(result, rejected=(*unseen, *result.rejected))
    write_camera(command.out, result)
    write_atomically(picture, calibration_picture(result))
    for line in summary(result):
        print(line)
    print(f"{command.out}; {picture}")
    return 1 if result.rejected else 0


def solve(command: arguments.Calibrate, views: Sequence[BoardView], exifs: Sequence[Exif]) -> Calibration:
    """Returns the camera; from one photograph of the command only a rough start, by its EXIF focal length.

    Raises:
        CalibrationError: too few photographs, of several sizes, from one tilt, or one without a focal length.
    """
    if len(command.photos) > 1:
        return calibrate(views) if command.keep_all else without_outliers(views)
    if not views:
        raise CalibrationError("calibration: no photograph shows the board")
    focal = next(iter(exifs)).focal_length_35mm
    if focal is None:
        raise CalibrationError(
            f"{views[0].name}: one photograph is only a rough start, and this one has no EXIF focal length (35 mm "
            "equivalent); give 10 to 20 photographs of the board from several tilts"
        )
    return rough_start(views[0], focal)


def look(photos: Sequence[Path], board: Board) -> tuple[list[BoardView], list[Exif], list[Rejected]]:
    """Returns what each photograph shows; one that cannot be read or shows no board is reported and left out."""
    views, exifs, unseen = [], [], []
    for photo in photos:
        try:
            stored = read_photo(photo)
            view = detect(board, grey_picture(stored.pixels, stored.is_linear), str(photo))
        except TorchlightError as error:
            fail(str(error))
            unseen.append(Rejected(photo.name, str(error).removeprefix(f"{photo}: ")))
            continue
        views.append(replace(view, name=photo.name))
        exifs.append(stored.exif)
    return views, exifs, unseen


def summary(result: Calibration) -> list[str]:
    """Returns the camera with its standard deviations, the error of each photograph, and what was left out."""
    k = result.lens.intrinsics
    values = [*k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), *result.lens.distortion.tolist()]
    lines = [f"rms {result.rms:.4f} px over {len(result.views)} photographs, {result.lens.image_size} px"]
    for name, value, deviation in zip(PARAMETERS, values, result.deviations.tolist(), strict=True):
        lines.append(f"  {name} {value:12.5f}" + (f" +- {deviation:.5f}" if math.isfinite(deviation) else ""))
    for view, error in zip(result.views, result.errors, strict=True):
        lines.append(f"  {view.name}: {error:.3f} px, {len(view.points)} corners")
    lines += [f"  left out: {each.name}: {each.reason}" for each in result.rejected]
    return [*lines, f"rough: {result.rough}"] if result.rough else lines


def named_board(command: arguments.Calibrate) -> Board:
    """Returns the board that the options describe, after the ruler's check.

    Raises:
        ConfigError: not exactly one board, or sizes missing.
        CalibrationError: the ruler does not measure what it should.
    """
    named = [name for name in ("target", "chessboard", "charuco") if getattr(command, name) is not None]
    if len(named) != 1:
        found = " and ".join(f"--{name}" for name in named) or "none"
        raise ConfigError(f"expected exactly one of --target, --chessboard and --charuco, found {found}")
    if command.target is not None:
        board: Board = read_target(command.target)
    elif command.chessboard is not None:
        columns, rows = counts("--chessboard", command.chessboard)
        board = Chessboard(columns, rows, length("--square", command.square), command.window)
    else:
        columns, rows = counts("--charuco", command.charuco or "")
        square, marker = length("--square", command.square), length("--marker", command.marker)
        board = Charuco(columns, rows, square, marker, command.dictionary)
    if command.ruler is not None:
        check_ruler(printed_length(board), length("--ruler", command.ruler))
    return board


def printed_length(board: Board) -> float:
    """Returns what --ruler measures: the sheet's printed line, or a board's first row of squares from end to end.

    A chessboard of c inner corners has c + 1 squares in a row.
    """
    if isinstance(board, Sheet):
        return RULER_LENGTH
    return board.square * (board.columns + 1 if isinstance(board, Chessboard) else board.columns)


def counts(option: str, text: str) -> tuple[int, int]:
    """Returns the two whole numbers of a text such as 9x6."""
    match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", text.strip().lower())
    if match is None:
        raise ConfigError(f"{option} {text}: expected columns x rows such as 9x6")
    return int(match[1]), int(match[2])


def length(option: str, text: str | None) -> float:
    """Returns the millimetres of a text such as 28 or 28mm."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:mm)?", (text or "").strip())
    if match is None or not 0 < float(match[1]) < 1e6:
        shown = "missing" if text is None else text
        raise ConfigError(f"{option} {shown}: expected millimetres above 0, such as 28 or 28mm")
    return float(match[1])


def check_places(command: arguments.Calibrate) -> Path:
    """Returns where the picture goes; raises ConfigError or FormatError where nothing can be written or read."""
    if not command.photos:
        raise ConfigError("no photograph given; usage: torchlight calibrate PHOTO... --target target.yaml --out FILE")
    writer_for(command.out)
    check_writable(command.out.parent)
    picture = command.out.with_suffix(".png")
    for path in (command.out, picture):
        if path.exists() and not command.overwrite:
            raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")
    return picture
