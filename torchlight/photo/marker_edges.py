"""Corners of square markers to a few hundredths of a pixel: where the straight lines along their sides cross.

A corner itself is a few blurred pixels; its two sides are many. Across a blurred step from dark D to bright B, at any
blur and any brightness, the profile's area tells where the step is: distance = integral of (v - D) / (B - D).

Lens and sensor blur light, not codes: v is linear light. On sRGB codes, which favour the bright side, every dark square
would be too small, by 0.2 pixels on each side where the photograph is sharp and 0.6 where it is blurred by 1.2 pixels;
a sheet 1 m away would seem 0.15 mm farther at a focal length of 1450 pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

STEP = 0.25  # pixels between the values of a profile
REACH = 0.7  # of a cell, to each side: the next cell inside may be white
SIDE_ENDS = 0.12  # of a side, left out at both ends, where the blur of the corners reaches
LEAST_CONTRAST = 0.5  # of the side's median: less is a shadow's edge, an object or dirt
FARTHEST = 0.5  # of a cell: a crossing is not believed that lies farther from where the corner was found
ROUNDS = 2
PATCH_RIM = 30  # pixels
_TERMINATION = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


def refined_corners(
    grey: UInt8[np.ndarray, "height width"], corners: Float[np.ndarray, "4 2"], cells: int
) -> Float[np.ndarray, "4 2"]:
    """Returns a marker's corners, refined; a corner whose sides are not clear is OpenCV's `cornerSubPix`.

    Args:
        grey: the photograph, sRGB codes.
        corners: as a detector found them, in order around the marker.
        cells: along a marker's side, its black rim included.
    """
    low = np.maximum(corners.min(axis=0).astype(int) - PATCH_RIM, 0)
    high = corners.max(axis=0).astype(int) + PATCH_RIM
    patch = np.ascontiguousarray(grey[low[1] : high[1], low[0] : high[0]])
    return _refined(patch, corners - low, cells) + low


def _refined(grey: NDArray[np.uint8], corners: NDArray[np.floating], cells: int) -> NDArray[np.float64]:
    start = _by_gradients(grey, corners, cells)
    farthest = FARTHEST * np.linalg.norm(start - np.roll(start, -1, axis=0), axis=1).min() / cells
    values = _linear_light(grey)
    result = start
    for _ in range(ROUNDS):
        area = float(cv2.contourArea(result.astype(np.float32)))
        lines = [_side_line(values, result[side], result[(side + 1) % 4], area / cells) for side in range(4)]
        crossed = [_crossing(lines[side - 1], lines[side], result[side]) for side in range(4)]
        near = [np.linalg.norm(point - begin) <= farthest for point, begin in zip(crossed, start, strict=True)]
        result = np.where(np.array(near)[:, None], np.stack(crossed), start)
    return result


def _linear_light(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Returns what sRGB codes stand for, IEC 61966-2-1."""
    code = np.arange(256) / 255
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return light.astype(np.float32)[grey]


def _by_gradients(grey: NDArray[np.uint8], corners: NDArray[np.floating], cells: int) -> NDArray[np.float64]:
    """Returns the corners by OpenCV, in a window that ends before the marker's next cell."""
    shortest = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1).min()
    window = int(max(2, round(0.8 * shortest / cells)))
    given = corners.reshape(-1, 1, 2).astype(np.float32)
    return cv2.cornerSubPix(grey, given, (window, window), (-1, -1), _TERMINATION).reshape(4, 2).astype(np.float64)


Line = tuple[NDArray[np.float64], NDArray[np.float64]]


def _side_line(
    values: NDArray[np.float32], begin: NDArray[np.float64], end: NDArray[np.float64], rim_area: float
) -> Line | None:
    """Returns a point and the direction of the line along a side, or None where the photograph does not show it.

    A marker seen at a slant has a black rim that is narrower across than a cell is long: rim_area / length.
    """
    length = float(np.linalg.norm(end - begin))
    reach = REACH * rim_area / max(length, 1.0)
    if reach < 4 * STEP:
        return None
    along = (end - begin) / length
    outward = np.array([along[1], -along[0]])
    place = np.linspace(SIDE_ENDS, 1 - SIDE_ENDS, max(8, int(length))) * length
    across = np.arange(-reach, reach, STEP)
    spots = (begin + place[:, None, None] * along + across[:, None] * outward).astype(np.float32)
    profile = cv2.remap(values, spots[..., 0], spots[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    offset, clear = _steps(profile, across)
    if clear.sum() < 5:
        return None
    slope, level = _robust_line(place[clear], offset[clear])
    return begin + level * outward, along + slope * outward


def _steps(profile: NDArray[np.float64], across: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Returns where each profile steps from one level to the other, and which profiles do so clearly."""
    first, last = profile[:, :3].mean(axis=1), profile[:, -3:].mean(axis=1)
    contrast = last - first
    usual = np.median(contrast)
    clear = contrast * np.sign(usual) > LEAST_CONTRAST * abs(usual)
    share = (profile - first[:, None]) / np.where(clear, contrast, 1.0)[:, None]
    area = (share.sum(axis=1) - 0.5) * STEP  # the trapezoid rule
    return across[-1] - area, clear


def _robust_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Returns slope and intercept; values far from the first fit's median residual are left out of the second."""
    slope, level = np.polyfit(x, y, 1)
    rest = np.abs(y - slope * x - level)
    near = rest <= max(0.05, 3 * float(np.median(rest)))
    slope, level = np.polyfit(x[near], y[near], 1)
    return float(slope), float(level)


def _crossing(one: Line | None, other: Line | None, otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    if one is None or other is None:
        return otherwise
    directions = np.stack([one[1], -other[1]], axis=1)
    if abs(np.linalg.det(directions)) < 1e-3:
        return otherwise
    along = np.linalg.solve(directions, other[0] - one[0])
    return one[0] + along[0] * one[1]
