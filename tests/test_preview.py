"""The light as an 8-bit picture: one exposure for all, and what it clips."""

from __future__ import annotations

import math
from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image

from torchlight.light.environment import EnvironmentMap
from torchlight.preview import encode_png, preview, to_srgb8


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(png)))


def lamp(value: float) -> EnvironmentMap:
    """A sky of 1 with one pixel of another value at the zenith's row."""
    radiance = torch.ones(3, 16, 32, dtype=torch.float64)
    radiance[:, 4, 7] = value
    return EnvironmentMap(radiance)


def test_the_preview_has_one_exposure_for_all() -> None:
    shown = preview(lamp(1.0))
    assert shown.scale == pytest.approx(0.8)
    assert shown.clipped_flux == pytest.approx(0.0, abs=1e-9)
    assert (pixels(shown.png) == 231).all()  # 0.8 in sRGB
    assert pixels(shown.png).shape == (16, 32, 3)


def test_clipped_flux_is_what_lies_above_white() -> None:
    shown = preview(lamp(1000.0))
    heights = np.arange(17) * math.pi / 16
    flux = np.clip(np.cos(heights[:-1]) ** 2 - np.cos(heights[1:]) ** 2, 0, None) / 32  # of pi: sin^2 per row
    flux[8:] = 0
    total = flux.sum() * 32 + 999 * flux[4]
    lost = flux[4] * (1000 - 1 / shown.scale)
    assert shown.clipped_flux == pytest.approx(lost / total, rel=1e-6)


def test_the_exposure_does_not_matter() -> None:
    dim = preview(EnvironmentMap(lamp(50.0).radiance * 1e-6))
    assert dim.png == preview(lamp(50.0)).png
    assert dim.clipped_flux == pytest.approx(preview(lamp(50.0)).clipped_flux, rel=1e-6)


def test_black_and_negative_light_have_a_preview() -> None:
    black = preview(EnvironmentMap(torch.zeros(3, 8, 16)))
    assert (black.clipped_flux, pixels(black.png).max()) == (0.0, 0)
    mixed = torch.ones(3, 8, 16)
    mixed[:, 2:] = -1
    shown = preview(EnvironmentMap(mixed, nonnegative=False))
    assert (pixels(shown.png)[2:] == 0).all()
    assert shown.clipped_flux == pytest.approx(0.0, abs=1e-9)


def test_srgb_literals() -> None:
    linear = torch.tensor([-1.0, 0.0, 0.0031308, 0.5, 1.0, 7.0]).expand(3, 1, 6)
    assert to_srgb8(linear)[0, :, 0].tolist() == [0, 0, 10, 188, 255, 255]


def test_png_round_trip() -> None:
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 4), dtype=np.uint8)
    assert np.array_equal(pixels(encode_png(image)), image)
