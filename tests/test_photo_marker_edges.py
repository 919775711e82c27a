"""Corners of blurred, noisy, shaded squares whose true corners are known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from sheet_photo import srgb

from torchlight.photo.marker_edges import refined_corners

FINE = 16


def blurred(corners: NDArray[np.float64], blur: float, shade: float = 0.0, noise: float = 0.0) -> NDArray[np.uint8]:
    """Returns a dark square on white, sampled at 16 times the resolution, blurred in linear light, stored as sRGB."""
    place = (np.arange(80 * FINE, dtype=np.float32) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(place, place)
    inside = np.ones_like(x, dtype=bool)
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside &= (end[0] - begin[0]) * (y - begin[1]) - (end[1] - begin[1]) * (x - begin[0]) > 0
    canvas = np.where(inside, np.float32(8), np.float32(220))
    canvas *= 1 - shade * np.linspace(0, 1, 80 * FINE, dtype=np.float32)
    canvas = cv2.GaussianBlur(canvas, (0, 0), blur * FINE)
    small = canvas.reshape(80, FINE, 80, FINE).mean(axis=(1, 3))
    small += np.random.default_rng(1).normal(0, noise, small.shape)
    return srgb(small.astype(np.float64))


def turned_square(degrees: float, side: float = 32.0) -> NDArray[np.float64]:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2 @ turn.T + (40.3, 39.1)


@pytest.mark.parametrize("blur", [0.5, 0.8, 1.2])
def test_a_dark_square_is_as_large_as_it_is_although_codes_favour_the_bright_side(blur: float) -> None:
    true = turned_square(20.0)
    found = refined_corners(blurred(true, blur), true.astype(np.float32), 6)
    outward = (true - true.mean(axis=0)) / np.linalg.norm(true - true.mean(axis=0), axis=1, keepdims=True)
    growth = ((found - true) * outward).sum(axis=1)
    assert np.abs(growth).max() < 0.04


@pytest.mark.parametrize("degrees", [0.0, 7.0, 33.0])
@pytest.mark.parametrize("blur", [0.5, 1.2])
def test_corners_are_found_to_a_tenth_of_a_pixel_whatever_blur_and_shading(degrees: float, blur: float) -> None:
    true = turned_square(degrees)
    start = true + np.random.default_rng(int(degrees)).uniform(-0.8, 0.8, true.shape)
    found = refined_corners(blurred(true, blur, shade=0.3, noise=2.0), start.astype(np.float32), 6)
    assert np.linalg.norm(found - true, axis=1).max() < 0.1


def test_a_side_that_is_covered_leaves_the_corner_where_gradients_put_it() -> None:
    true = turned_square(10.0)
    picture = blurred(true, 0.7)
    picture[:, 52:] = 128  # something grey lies over the right part
    found = refined_corners(picture, true.astype(np.float32), 6)
    assert np.isfinite(found).all()
    assert np.linalg.norm(found - true, axis=1)[[0, 3]].max() < 0.15
