"""Calibration boards and what a photograph shows of them: chessboards, ChArUco boards and the printed sheet.

The only place that knows OpenCV's boards. Their z axis points into the table; every point here is returned in a world
whose z = 0 is the board and whose +z points towards the camera, x along a row and y up the board.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy.typing import NDArray
from torch import Tensor

from torchlight.errors import CalibrationError, ConfigError
from torchlight.photo.marker_edges import refined_corners
from torchlight.photo.radiometry import encode
from torchlight.photo.target import Sheet, marker_corners

MIN_MARKERS = 4
MIN_CORNERS = 6
MAX_WINDOW = 11  # half a side, in pixels: more adds nothing but lens distortion
WINDOW_SHARE = 4  # the window reaches a quarter of the way to the nearest corner: clear of a rim that cuts its squares
PIXELS_PER_CELL = 8  # of a marker, where its cells are read; at OpenCV's 4, blurred markers of 25 pixels are lost
_TERMINATION = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
_UPWARDS = torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64)


@dataclass(frozen=True)
class Chessboard:
    """A chessboard.

    Attributes:
        columns: inner corners along a row.
        rows: inner corners along a column.
        square: side of a square.
        window: half the side of the patch that locates a corner, in pixels; None = a quarter of the way to the nearest
            other corner, at most 11.
    """

    columns: int
    rows: int
    square: float
    window: int | None = None

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 < self.square < float("inf"):
            raise ConfigError(
                f"chessboard: expected at least 3 x 3 inner corners and a square above 0, "
                f"got {self.columns}x{self.rows} of {self.square:g}"
            )
        if self.window is not None and self.window < 1:
            raise ConfigError(f"window: expected at least 1 pixel, got {self.window}")


@dataclass(frozen=True)
class Charuco:
    """A ChArUco board; boards printed by OpenCV before 4.6, and by calib.io, are recognised by themselves.

    Attributes:
        columns: squares along a row.
        rows: squares along a column.
        square: side of a square.
        marker: side of a marker.
        dictionary: OpenCV's name, such as DICT_6X6_250.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 < self.marker < self.square < float("inf"):
            raise ConfigError(
                "charuco: expected at least 3 x 3 squares and 0 < marker < square, "
                f"got {self.columns}x{self.rows} of {self.square:g} with markers of {self.marker:g}"
            )
        named_dictionary(self.dictionary)


Board = Chessboard | Charuco | Sheet


@dataclass(frozen=True, eq=False)
class BoardView:
    """What one photograph shows of a board.

    Attributes:
        name: of the photograph.
        points: corners on the board, in its world (z = 0).
        pixels: where the photograph shows them, pixel centres at integers.
        image_size: width and height of the photograph.
    """

    name: str
    points: Float[Tensor, "corners 3"]
    pixels: Float[Tensor, "corners 2"]
    image_size: tuple[int, int]


def detect(board: Board, grey: UInt8[np.ndarray, "height width"], name: str) -> BoardView:
    """Returns what a grey photograph shows of a board.

    Raises:
        CalibrationError: the board is not there, or too little of it.
    """
    height, width = grey.shape
    if isinstance(board, Chessboard):
        points, pixels = _chessboard(board, grey, name)
    elif isinstance(board, Charuco):
        points, pixels = _charuco(board, grey, name)
    else:
        points, pixels = _sheet(board, grey, name)
    return BoardView(name, points, pixels, (width, height))


def grey_picture(pixels: Float[Tensor, "3 height width"], is_linear: bool = False) -> UInt8[np.ndarray, "height width"]:
    """Returns what detectors take: 8-bit luma of an encoded photograph; linear values are encoded as sRGB first."""
    from kornia.color import rgb_to_grayscale

    encoded = encode(pixels.clamp(0, 1), "srgb") if is_linear else pixels.clamp(0, 1)
    return np.ascontiguousarray((rgb_to_grayscale(encoded.nan_to_num())[0] * 255).round().byte().numpy())


def named_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Returns OpenCV's dictionary of a name such as DICT_4X4_50; ConfigError where there is none."""
    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if number is None:
        raise ConfigError(f"dictionary: OpenCV has no {name}; for example DICT_4X4_50 or DICT_6X6_250")
    return cv2.aruco.getPredefinedDictionary(number)


def marker_cells(dictionary: str, identity: int) -> Bool[Tensor, "cells cells"]:
    """Returns which cells of a marker are black, its black rim included, row 0 at the top."""
    source = named_dictionary(dictionary)
    cells = source.markerSize + 2
    picture = source.generateImageMarker(identity, cells, borderBits=1)
    return torch.from_numpy(picture) < 128


def _chessboard(board: Chessboard, grey: NDArray[np.uint8], name: str) -> tuple[Tensor, Tensor]:
    found, corners = cv2.findChessboardCorners(grey, (board.columns, board.rows))
    if not found:
        raise CalibrationError(
            f"{name}: no chessboard of {board.columns} x {board.rows} inner corners is seen whole; "
            "check the counts (corners, not squares), the light and the sharpness"
        )
    corners = corners.reshape(-1, 1, 2).astype(np.float32)
    window = _window(corners.reshape(board.rows, board.columns, 2)) if board.window is None else board.window
    refined = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), _TERMINATION)
    grid = _seen_from_above(refined.reshape(board.rows, board.columns, 2))
    row, column = np.mgrid[: board.rows, : board.columns].astype(np.float64) * board.square
    points = torch.from_numpy(np.stack([column, row, np.zeros_like(row)], axis=-1).reshape(-1, 3))
    return points * _UPWARDS, torch.from_numpy(grid.reshape(-1, 2).astype(np.float64))


def _window(grid: NDArray[Any]) -> int:
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1).min()
    return int(np.clip(min(across, down) / WINDOW_SHARE, 2, MAX_WINDOW))


def _seen_from_above(grid: NDArray[Any]) -> NDArray[Any]:
    """Returns the corners with columns and rows in the sense of x right and y down, never mirrored."""
    along_row = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    along_column = grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    turns_right = along_row[0] * along_column[1] - along_row[1] * along_column[0] > 0
    return grid if turns_right else grid[:, ::-1]


def _charuco(board: Charuco, grey: NDArray[np.uint8], name: str) -> tuple[Tensor, Tensor]:
    found = [_charuco_corners(board, grey, legacy) for legacy in (False, True)]
    points, pixels = max(found, key=lambda item: len(item[0]))  # the wrong pattern finds few or none
    if len(points) < MIN_CORNERS:
        raise CalibrationError(
            f"{name}: {len(points)} corners of the ChArUco board are seen, at least {MIN_CORNERS} are needed; "
            "check --charuco (squares, not corners), the dictionary, the light and the sharpness"
        )
    return points, pixels


def _charuco_corners(board: Charuco, grey: NDArray[np.uint8], legacy: bool) -> tuple[Tensor, Tensor]:
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.marker, named_dictionary(board.dictionary)
    )
    made.setLegacyPattern(legacy)
    corners, identities, _, _ = cv2.aruco.CharucoDetector(made).detectBoard(grey)
    if corners is None or identities is None or len(corners) == 0:
        return torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, 2, dtype=torch.float64)
    points = np.asarray(made.getChessboardCorners(), dtype=np.float64)[np.asarray(identities, dtype=np.int64).ravel()]
    return torch.from_numpy(points) * _UPWARDS, torch.from_numpy(corners.reshape(-1, 2).astype(np.float64))


def _sheet(sheet: Sheet, grey: NDArray[np.uint8], name: str) -> tuple[Tensor, Tensor]:
    dictionary = named_dictionary(sheet.dictionary)
    settings = cv2.aruco.DetectorParameters()
    settings.perspectiveRemovePixelPerCell = PIXELS_PER_CELL
    detector = cv2.aruco.ArucoDetector(dictionary, settings)
    corners, identities, _ = detector.detectMarkers(grey)
    numbers = [] if identities is None else np.asarray(identities, dtype=np.int64).ravel().tolist()
    of_sheet = [index for index, number in enumerate(numbers) if number < len(sheet.markers)]
    if len(of_sheet) < MIN_MARKERS:
        raise CalibrationError(
            f"{name}: {len(of_sheet) or 'no'} marker{'s' if len(of_sheet) != 1 else ''} of the sheet "
            f"{'are' if len(of_sheet) != 1 else 'is'} seen, at least {MIN_MARKERS} are needed; "
            "check that it is this sheet, that it is sharp, and that its markers are not in hard shadow"
        )
    points = marker_corners(sheet)[[numbers[index] for index in of_sheet]].reshape(-1, 3)
    cells = dictionary.markerSize + 2
    pixels = [refined_corners(grey, np.asarray(corners[index]).reshape(4, 2), cells) for index in of_sheet]
    return points, torch.from_numpy(np.concatenate(pixels))
