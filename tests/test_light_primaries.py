"""Matrices between sets of primaries, against the digits that their standards print."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light.environment import LUMINANCE
from torchlight.light.primaries import (
    PRIMARIES,
    check_primaries,
    conversion,
    convert_primaries,
    named,
    rgb_to_xyz,
)

NAMES = tuple(PRIMARIES)


def between(source: str, target: str) -> Tensor:
    return conversion(PRIMARIES[source], PRIMARIES[target])


def test_rec709_to_xyz_is_the_published_matrix() -> None:
    """IEC 61966-2-1 prints four digits."""
    published = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    assert_close(rgb_to_xyz(PRIMARIES["rec709"]), torch.tensor(published, dtype=torch.float64), rtol=0, atol=5.1e-5)
    assert_close(rgb_to_xyz(PRIMARIES["rec709"])[1], torch.tensor(LUMINANCE, dtype=torch.float64), rtol=0, atol=5.1e-5)


def test_aces_matrices_are_the_published_ones() -> None:
    """The Academy's reference implementation prints ten digits; no adaptation, since the white is the same."""
    published = [
        [0.6954522414, 0.1406786965, 0.1638690622],
        [0.0447945634, 0.8596711185, 0.0955343182],
        [-0.0055258826, 0.0040252103, 1.0015006723],
    ]
    assert_close(between("acescg", "aces2065-1"), torch.tensor(published, dtype=torch.float64), rtol=0, atol=5.1e-11)
    to_xyz = [
        [0.6624541811, 0.1340042065, 0.1561876870],
        [0.2722287168, 0.6740817658, 0.0536895174],
        [-0.0055746495, 0.0040607335, 1.0103391003],
    ]
    assert_close(rgb_to_xyz(PRIMARIES["acescg"]), torch.tensor(to_xyz, dtype=torch.float64), rtol=0, atol=5.1e-11)


def test_acescg_to_rec709_is_the_published_matrix() -> None:
    """As renderers and games print it: ACES white adapted to D65 by Bradford's matrix."""
    published = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    assert_close(between("acescg", "rec709"), torch.tensor(published, dtype=torch.float64), rtol=0, atol=5.1e-6)


def test_rec709_to_rec2020_is_the_published_matrix() -> None:
    """ITU-R BT.2087 prints four digits."""
    published = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
    assert_close(between("rec709", "rec2020"), torch.tensor(published, dtype=torch.float64), rtol=0, atol=5.1e-5)


@pytest.mark.parametrize("target", NAMES)
@pytest.mark.parametrize("source", NAMES)
def test_white_stays_white_and_there_and_back_is_nothing(source: str, target: str) -> None:
    matrix = between(source, target)
    assert_close(matrix.sum(dim=1), torch.ones(3, dtype=torch.float64), rtol=0, atol=1e-12)
    assert_close(between(target, source) @ matrix, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-12)


def test_a_wide_colour_is_negative_and_a_red_that_came_back_in_float32_is_red() -> None:
    green = torch.tensor([0.0, 1.0, 0.0])[:, None]
    assert convert_primaries(green, PRIMARIES["acescg"], PRIMARIES["rec709"])[0].item() == pytest.approx(
        -0.62179, abs=1e-5
    )
    for colour in torch.eye(3):
        there = convert_primaries(colour[:, None], PRIMARIES["rec709"], PRIMARIES["acescg"])
        back = convert_primaries(there, PRIMARIES["acescg"], PRIMARIES["rec709"])[:, 0]
        assert bool((back >= 0).all())
        assert_close(back, colour, rtol=0, atol=1e-6)


def test_names_survive_rounding() -> None:
    assert [named([round(value, 3) for value in PRIMARIES[name]]) for name in NAMES] == list(NAMES)
    assert named((0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 1 / 3, 1 / 3)) is None  # Radiance's own


def test_what_is_no_set_of_primaries_is_refused() -> None:
    with pytest.raises(ConfigError, match="eight finite numbers"):
        rgb_to_xyz((0.64, 0.33))
    with pytest.raises(ConfigError, match="one line"):
        rgb_to_xyz((0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.3290))
    with pytest.raises(ConfigError, match="choose one of rec709"):
        check_primaries("p3")
