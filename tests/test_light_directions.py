"""Directions and angles: literals, accuracy at the poles, round trips."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from torchlight.light.directions import from_angles, to_angles


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(
    ("theta", "phi", "expected"),
    [
        (0.0, 1.0, (0.0, 0.0, 1.0)),
        (math.pi / 2, 0.0, (1.0, 0.0, 0.0)),
        (math.pi / 2, math.pi / 2, (0.0, 1.0, 0.0)),
        (math.pi / 2, -math.pi / 2, (0.0, -1.0, 0.0)),
        (math.pi, 0.0, (0.0, 0.0, -1.0)),
        (math.pi / 4, math.pi, (-math.sqrt(0.5), 0.0, math.sqrt(0.5))),
    ],
)
def test_from_angles_has_literal_values(theta: float, phi: float, expected: tuple[float, float, float]) -> None:
    actual = from_angles(torch.tensor(theta, dtype=torch.float64), torch.tensor(phi, dtype=torch.float64))
    assert_close(actual, vector(*expected), rtol=0, atol=1e-15)


def test_to_angles_has_literal_values() -> None:
    directions = torch.stack([vector(0, 0, 2), vector(0, 3, 0), vector(-1, -1, 0), vector(0, 0, -1), vector(1, 0, 1)])
    theta, phi = to_angles(directions)
    assert_close(theta, vector(0, math.pi / 2, math.pi / 2, math.pi, math.pi / 4), rtol=0, atol=1e-15)
    assert_close(phi, vector(0, math.pi / 2, -3 * math.pi / 4, 0, 0), rtol=0, atol=1e-15)


def test_small_polar_angles_keep_their_digits() -> None:
    theta, _ = to_angles(vector(3e-9, 4e-9, 1.0))
    assert_close(theta, torch.tensor(5e-9, dtype=torch.float64), rtol=1e-14, atol=0)


@given(theta=st.floats(1e-3, math.pi - 1e-3), phi=st.floats(-3.14, 3.14), length=st.floats(0.1, 10.0))
def test_angles_survive_the_round_trip(theta: float, phi: float, length: float) -> None:
    given_angles = vector(theta), vector(phi)
    direction = from_angles(*given_angles)
    assert_close(direction.norm(dim=-1), vector(1.0), rtol=1e-14, atol=0)
    assert_close(to_angles(length * direction), given_angles, rtol=0, atol=1e-12)


def test_angles_broadcast_and_keep_the_dtype() -> None:
    directions = from_angles(torch.rand(4, 1), torch.rand(3))
    assert directions.shape == (4, 3, 3)
    assert directions.dtype == torch.float32
    assert to_angles(directions)[1].shape == (4, 3)
