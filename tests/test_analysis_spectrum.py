"""Transfer spectra: the clamped cosine, a pinhole's flat spectrum, slices past a block's edge."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.spectrum import (
    clamped_cosine,
    energy_per_degree,
    representative_samples,
    slices,
    total_energy,
    transfer_harmonics,
)
from torchlight.geometry import primitives
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.transfer import Transfer, transport

EMPTY = torch.zeros(0, 3, 3, dtype=torch.float64)


def lid(height: float, radius: float, outer: float = 400.0, segments: int = 256) -> Tensor:
    """A ring of triangles: a plate at a height with a round hole in its middle."""
    angle = torch.arange(segments, dtype=torch.float64) * (2 * math.pi / segments)
    rings = [
        torch.stack([r * angle.cos(), r * angle.sin(), torch.full_like(angle, height)], dim=1) for r in (radius, outer)
    ]
    inner, rim = rings
    lower = torch.stack([inner, rim, rim.roll(-1, 0)], dim=1)
    return torch.cat([lower, torch.stack([inner, rim.roll(-1, 0), inner.roll(-1, 0)], dim=1)])


# --- nothing on the plane ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plane() -> Transfer:
    return transport(Scene(EMPTY, Receiver((0.0, 0.0), (2.0, 1.0), (2, 1))), 16, 2)


def test_the_clamped_cosine_has_the_known_values() -> None:
    """A_l = pi, 2 pi / 3, pi / 4, 0, -pi / 24, 0, pi / 64 (Ramamoorthi and Hanrahan 2001)."""
    factors = clamped_cosine(6) / torch.sqrt((2 * torch.arange(7) + 1).double() / (4 * math.pi))
    expected = [math.pi, 2 * math.pi / 3, math.pi / 4, 0.0, -math.pi / 24, 0.0, math.pi / 64]
    assert_close(factors, torch.tensor(expected, dtype=torch.float64), rtol=1e-14, atol=1e-15)


def test_an_empty_plane_has_the_clamped_cosine_s_spectrum(plane: Transfer) -> None:
    harmonics = transfer_harmonics(plane, 11)
    assert harmonics.dtype == torch.float64
    expected = torch.zeros(144, dtype=torch.float64)
    degrees = torch.arange(12)
    expected[degrees * (degrees + 1)] = clamped_cosine(11)
    assert_close(harmonics, expected.expand(2, -1), rtol=0, atol=1e-6)
    assert_close(energy_per_degree(harmonics), clamped_cosine(11).square().expand(2, -1), rtol=0, atol=1e-6)


def test_an_empty_plane_has_99_percent_of_its_energy_up_to_degree_2(plane: Transfer) -> None:
    share = energy_per_degree(transfer_harmonics(plane, 2)).sum(dim=1) / (2 * math.pi / 3)
    expected = (1 / 4 + 1 / 3 + 5 / 64) / (2 / 3)
    assert_close(share, torch.full_like(share, expected), rtol=1e-6, atol=0)
    assert expected > 0.99


def test_the_total_energy_of_an_empty_plane_is_the_integral_of_the_squared_cosine(plane: Transfer) -> None:
    found = total_energy(plane)
    assert_close(found, torch.full_like(found, 2 * math.pi / 3), rtol=1e-6, atol=0)


# --- a lid with a hole ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("radius", "x"), [(0.1, 0.0), (0.1, 1.0), (0.05, 0.0), (0.05, 0.5), (0.05, 1.0)])
def test_a_pinhole_has_a_flat_spectrum(radius: float, x: float) -> None:
    """Energy per degree / (2l + 1) is that of a point, E^2 / 4 pi with E the flux through the hole, up to h / 4r."""
    receiver = Receiver((x, 0.0), (0.01, 0.01), (1, 1))  # under the hole, and up to 45 degrees beside it
    found = transport(Scene(lid(1.0, radius), receiver), 64, 8)
    degree = int(1 / (4 * radius))
    flat = energy_per_degree(transfer_harmonics(found, degree)) / (2 * torch.arange(degree + 1) + 1)
    assert_close(flat / flat[:, :1], torch.ones_like(flat), rtol=0, atol=0.1)
    point = found.transport.double().sum(dim=1).square() / (4 * math.pi)
    assert_close(flat[:, 0], point, rtol=1e-3, atol=0)


def test_a_pinhole_sees_the_directions_round_the_normal_equally_well() -> None:
    """Texels of the top face lie h / 4 apart on the plane; those within 45 degrees have well-separated spots."""
    receiver = Receiver((0.0, 0.0), (2.6, 2.6), (26, 26))
    found = transport(Scene(lid(1.0, 0.1), receiver), 8, 8)
    directions = cubemap.texel_directions(8, 5)[cubemap.visible_texels(8)]
    steep = found.transport[:, directions[:, 2] > math.cos(math.pi / 4)].double()
    values = torch.linalg.svdvals(steep)
    assert steep.shape[1] >= 44
    assert values[0] / values[-1] < 10


# --- slices --------------------------------------------------------------------------------------------------------


def test_a_slice_ends_at_the_block_s_upper_edge() -> None:
    """A sample 1.5 in front of a block of height 1: free up to atan(1.5) from the normal, hidden beyond."""
    receiver = Receiver((-2.0, 0.0), (0.2, 0.2), (1, 1))
    scene = Scene(primitives.box((1.0, 1.0, 1.0)), receiver)
    found = slices(scene, torch.tensor([0]), 901)
    assert_close(found.azimuth_radians, torch.zeros(1, dtype=torch.float64), rtol=0, atol=1e-12)
    angle = found.angle_radians
    free = angle < math.atan(1.5)
    clear = (angle - math.atan(1.5)).abs() > 0.01
    expected = torch.where(free, angle.cos(), 0.0)
    assert_close(found.values[0][clear], expected[clear], rtol=0, atol=1e-12)


def test_slices_of_an_empty_scene_are_the_whole_cosine() -> None:
    scene = Scene(EMPTY, Receiver((0.0, 0.0), (1.0, 1.0), (2, 2)))
    found = slices(scene, torch.tensor([0, 3]), 11)
    assert_close(found.values, found.angle_radians.cos().expand(2, -1), rtol=0, atol=0)


def test_representative_samples_go_from_deep_to_faint_shadow() -> None:
    scene = Scene(primitives.box((1.0, 1.0, 1.0)), Receiver((0.0, 0.0), (6.0, 6.0), (12, 12)))
    found = transport(scene, 4, 4)
    lit = found.transport.sum(dim=1)
    used = (lit > 0.1).nonzero()[:, 0]
    chosen = representative_samples(found, used)
    assert set(chosen.tolist()) <= set(used.tolist())
    assert lit[chosen].tolist() == sorted(lit[chosen].tolist())
    assert representative_samples(found, used[:1]).tolist() == used[:1].tolist()
