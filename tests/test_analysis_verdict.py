"""The verdict in words, and the warning of `estimate`."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchlight.analysis.nullity import Nullity, equations, nullity
from torchlight.analysis.observability import Observability
from torchlight.analysis.sampling import random_rotations
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.analysis.verdict import blind_words, camera_azimuth, excess, verdict
from torchlight.camera import Camera
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.light import cubemap
from torchlight.light.bases import HaarCubemap, SphericalHarmonics, Texels
from torchlight.light.directions import to_angles
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (24, 24))
SCENE = block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER)
DIRECTIONS = cubemap.texel_directions(16, 5)[cubemap.visible_texels(16)]
ELEVATION = DIRECTIONS[:, 2].asin().rad2deg()
AZIMUTH = to_angles(DIRECTIONS)[1].rad2deg()


def seen_where(clear: Tensor) -> Observability:
    """A map whose texels are either fully determined or blind."""
    diagonal = clear.double()
    return Observability(diagonal, (1 - diagonal).sqrt(), clear, torch.ones(3, dtype=torch.float64), 16)


@pytest.mark.parametrize(
    ("blind", "words"),
    [
        (ELEVATION < -1, "nowhere"),
        (ELEVATION > -1, "everywhere"),
        (ELEVATION < 20, "below 20 degrees of elevation (3"),
        ((AZIMUTH > 30) & (AZIMUTH < 90), "azimuth 30 to 90 degrees ("),
        (AZIMUTH.abs() > 150, "azimuth 150 to -150 degrees ("),
        ((ELEVATION < 20) | (AZIMUTH.abs() < 45), "below 20 degrees of elevation; azimuth -45 to 45 degrees ("),
        (ELEVATION > 70, "above 70 degrees of elevation (5%"),
        (ELEVATION > 25, "above 25 degrees of elevation (5"),
        (AZIMUTH.abs() > 80, "azimuth 75 to -75 degrees ("),
        ((ELEVATION > 60) & (ELEVATION < 65), "scattered directions ("),
    ],
)
def test_blind_directions_are_named(blind: Tensor, words: str) -> None:
    assert blind_words(seen_where(~blind)).startswith(words)


def test_the_camera_s_side_is_named() -> None:
    seen = seen_where(~((AZIMUTH > -105) & (AZIMUTH < -75)))
    assert "camera's side" in blind_words(seen, math.radians(-90))
    assert "camera's side" not in blind_words(seen, math.radians(90))
    assert "camera" not in blind_words(seen)


def camera_at(x: float, y: float, z: float) -> Camera:
    pose = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    pose[:3, 3] = torch.tensor([-x, y, z], dtype=torch.float64)
    intrinsics = torch.tensor([[200.0, 0, 39.5], [0, 200, 39.5], [0, 0, 1]], dtype=torch.float64)
    return Camera(intrinsics, pose, (80, 80), torch.zeros(5, dtype=torch.float64))


def test_a_camera_overhead_has_no_side() -> None:
    assert camera_azimuth(SCENE) is None
    assert camera_azimuth(replace(SCENE, camera=camera_at(1.0, 1.0, 10.0))) is None
    assert camera_azimuth(replace(SCENE, camera=camera_at(0.0, -9.0, 3.0))) == pytest.approx(-math.pi / 2)
    moved = replace(SCENE, receiver=replace(RECEIVER, center=(5.0, -9.0)), camera=camera_at(0.0, -9.0, 3.0))
    assert abs(camera_azimuth(moved) or 0.0) == pytest.approx(math.pi)


def curve(means: list[float]) -> Nullity:
    counts = (torch.tensor(means).repeat(4, 1)[..., None] * torch.tensor([0, 20])).long()  # mean = 10 x the number
    return Nullity(counts, torch.ones(len(means), 2, dtype=torch.long), ("MATLAB", 1e-6, 1e-4, 1e-3))


def test_the_verdict_is_three_plain_lines() -> None:
    lines = verdict(curve([0.0, 0.05, 0.0, 0.05, 0.05, 0.2]), seen_where(ELEVATION > 20), None, 0.01)
    assert lines[0] == "harmonics: up to B = 5 (25 coefficients)"
    assert lines[1].startswith("detail: 6")
    assert "% of the upper hemisphere determined at 16x16, " in lines[1]
    assert lines[1].endswith("of 768 degrees of freedom at 1 % noise")
    assert lines[2].startswith("blind: below 20 degrees of elevation")
    assert verdict(curve([0.0, 0.2]), seen_where(ELEVATION > 20), None, 0.01)[0] == (
        "harmonics: up to B = 1 (1 coefficient)"
    )
    assert "not even" in verdict(curve([0.2]), seen_where(ELEVATION > 20), None, 0.01)[0]


# --- the warning of estimate ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    return transport(SCENE, 16, 4)


EVERY = torch.ones(RECEIVER.points, dtype=torch.bool)


def test_more_coefficients_than_samples_are_noticed_whatever_the_solver(transfer: Transfer) -> None:
    message = excess(transfer, EVERY, Texels(16), nonnegative=True)
    assert message is not None
    assert message.startswith("768 coefficients from 576 usable samples")
    assert excess(transfer, EVERY, HaarCubemap(16), nonnegative=False) == message
    assert "\n" not in message


def test_a_light_of_the_usual_size_is_no_excess(transfer: Transfer) -> None:
    assert excess(transfer, EVERY, SphericalHarmonics(5, 16), nonnegative=True) is None
    dense = Transfer(transfer.transport.repeat(2, 1), 16)
    assert excess(dense, EVERY.repeat(2), Texels(16), nonnegative=True) is None


def test_harmonics_beyond_the_recommended_bandwidth_are_noticed(transfer: Transfer) -> None:
    rows = equations(transfer_harmonics(transfer, 11), RECEIVER.points)
    recommended = nullity(rows, random_rotations(100, seed=0)).recommended()
    assert 2 <= recommended <= 6
    assert excess(transfer, EVERY, SphericalHarmonics(recommended - 1, 16), nonnegative=False) is None
    for degree in (recommended, 14):
        message = excess(transfer, EVERY, SphericalHarmonics(degree, 16), nonnegative=False)
        assert message is not None
        assert f"degree {degree} asks for bandwidth {degree + 1}" in message
        assert f"up to B = {recommended}" in message
        assert f"--degree {recommended - 1}," in message


def test_unconstrained_texels_that_are_mostly_undetermined_are_noticed(transfer: Transfer) -> None:
    dense = Transfer(transfer.transport.repeat(2, 1), 16)
    message = excess(dense, EVERY.repeat(2), Texels(16), nonnegative=False)
    assert message is not None
    assert message.startswith("768 coefficients, but about ")
    coarse = transport(SCENE, 2, 16)
    assert excess(coarse, EVERY, Texels(2), nonnegative=False) is None


def test_a_dark_scene_is_left_to_the_photograph_s_own_checks() -> None:
    dark = Transfer(torch.zeros(500, 12), 2)
    assert excess(dark, torch.ones(500, dtype=torch.bool), Texels(2), nonnegative=False) is None
