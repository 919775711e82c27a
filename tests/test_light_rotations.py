"""Rotations: literal vectors, conventions of sign and order, and what is refused."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light.rotations import about_axis, checked, is_about_z, parse_rotation, turns

X, Y, Z = torch.eye(3, dtype=torch.float64)


def same(found: Tensor, expected: Tensor) -> None:
    assert_close(found, expected, rtol=0, atol=1e-12)


def test_turns_are_counter_clockwise_seen_from_the_tip() -> None:
    same(about_axis((0.0, 0.0, 2.0), 90.0) @ X, Y)
    same(about_axis((1.0, 0.0, 0.0), 90.0) @ Y, Z)
    same(about_axis((0.0, 1.0, 0.0), 90.0) @ Z, X)
    same(about_axis((1.0, 1.0, 1.0), 120.0) @ X, Y)
    same(about_axis((0.0, 0.0, 1.0), 30.0) @ X, math.sqrt(0.75) * X + 0.5 * Y)


def test_quarter_turns_are_exact() -> None:
    for degrees in (-270.0, -90.0, 0.0, 180.0, 450.0):
        matrix = about_axis((0.0, 1.0, 0.0), degrees)
        assert torch.equal(matrix, matrix.round())


def test_several_turns_are_about_the_fixed_axes_first_one_first() -> None:
    same(turns([("x", 90.0), ("z", 90.0)]) @ Y, Z)  # y -> z by the first, and z stays
    same(turns([("z", 90.0), ("x", 90.0)]) @ Y, -X)


@pytest.mark.parametrize("text", ["90", "z:90", "z:30, z:60", "0,0,1,90", "0,-1,0, 1,0,0, 0,0,1"])
def test_one_turn_in_every_notation(text: str) -> None:
    same(parse_rotation(text), about_axis((0.0, 0.0, 1.0), 90.0))
    assert is_about_z(parse_rotation(text))
    assert not is_about_z(parse_rotation("x:90"))


def test_a_matrix_of_few_digits_is_made_a_rotation() -> None:
    matrix = parse_rotation("0.8660,-0.5,0, 0.5,0.8660,0, 0,0,1")
    same(matrix @ matrix.T, torch.eye(3, dtype=torch.float64))
    assert_close(matrix, about_axis((0.0, 0.0, 1.0), 30.0), rtol=0, atol=1e-4)


@pytest.mark.parametrize("text", ["", "north", "1,2", "w:30", "x:", "x:30,40", "1,0,0,0,1,0,0,0", "nan", "0,0,0,30"])
def test_what_is_no_rotation_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match="rotation") as caught:
        parse_rotation(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("factor", [2.0, -1.0, math.nan])
def test_scales_and_mirrors_are_refused(factor: float) -> None:
    with pytest.raises(ConfigError, match="without scale, shear or mirror"):
        checked(factor * torch.eye(3, dtype=torch.float64))
