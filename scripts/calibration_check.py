"""Calibrates from published photographs and compares with the published cameras: `--data DIR` holds them.

Prints one table. The chessboards of OpenCV appear three times: as published (patches of 23 pixels, every
photograph), without the photograph that does not fit, and by default, where a patch stays clear of the board's rim.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from torchlight.calibration import Calibration, calibrate, without_outliers
from torchlight.camera import Lens
from torchlight.io.cameras import read_lens
from torchlight.io.images import read_photo
from torchlight.photo.boards import BoardView, Charuco, Chessboard, detect, grey_picture
from torchlight.photo.pose import locate

DESK = torch.tensor([1658.9694003864618, 1662.38350414473, 960.0458349455579, 526.3300468244573], dtype=torch.float64)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with calib/ and photos/")
    data = parser.parse_args().data
    left = sorted((data / "calib" / "opencv_chessboard").glob("left*.jpg"))
    desk = sorted((data / "photos" / "desk_pencil" / "calib").glob("*.jpg"))
    published = four(read_lens(data / "calib" / "opencv_chessboard" / "left_intrinsics.yml"))
    print(f"{'photographs':34} {'used':>5} {'rms':>7} {'fx':>9} {'fy':>9} {'cx':>9} {'cy':>9}  off the published, %")
    row("OpenCV left, --window 11 --keep-all", calibrate(seen(left, Chessboard(9, 6, 25.0, 11))), published)
    row("OpenCV left, --window 11", without_outliers(seen(left, Chessboard(9, 6, 25.0, 11))), published)
    row("OpenCV left, default", without_outliers(seen(left, Chessboard(9, 6, 25.0))), published)
    row("desk_pencil, default", without_outliers(seen(desk, Chessboard(9, 6, 28.0))), DESK)
    charuco(data / "calib" / "opencv_charuco")


def seen(files: list[Path], board: Chessboard) -> list[BoardView]:
    """Returns what every photograph shows."""
    return [detect(board, grey_picture(read_photo(file).pixels), file.name) for file in files]


def four(lens: Lens) -> Tensor:
    """Returns fx fy cx cy."""
    return lens.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]


def row(name: str, found: Calibration, published: Tensor) -> None:
    """Prints one calibration, and how far off the published one it is."""
    values = four(found.lens)
    numbers = " ".join(f"{value:9.3f}" for value in values.tolist())
    off = " ".join(f"{value:+.3f}" for value in (100 * (values / published - 1)).tolist())
    print(f"{name:34} {len(found.views):5} {found.rms:7.4f} {numbers}  {off}")
    worst = max(zip(found.errors, (view.name for view in found.views), strict=True))
    deviations = " ".join(f"{value:9.3f}" for value in found.deviations[:4].tolist())
    print(f"{'  standard deviations':34} {'':5} {'':7} {deviations}  worst photograph {worst[1]}: {worst[0]:.2f} px")
    for each in found.rejected:
        print(f"  left out: {each.name}: {each.reason}")


def charuco(folder: Path) -> None:
    """Prints the pose of the ChArUco photograph under its published camera."""
    grey = grey_picture(read_photo(folder / "choriginal.jpg").pixels)
    view = detect(Charuco(5, 7, 40.0, 20.0, "DICT_6X6_250"), grey, "choriginal.jpg")
    pose = locate(view, read_lens(folder / "tutorial_camera_charuco.yml"))
    print(
        f"ChArUco photograph: {len(view.points)} corners, rms {pose.rms:.3f} px, largest "
        f"{pose.residuals.norm(dim=-1).max():.3f} px; +- {pose.position_deviation:.2f} mm, "
        f"{pose.turn_deviation_degrees:.3f} degrees (squares taken as 40 mm)"
    )


if __name__ == "__main__":
    main()
