"""Real spherical harmonics: literals, scipy, orthonormality, the addition theorem, rotation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import eval_legendre, sph_harm_y
from torch.testing import assert_close

from torchlight.light.directions import from_angles, to_angles
from torchlight.light.harmonics import real_spherical_harmonics


def random_directions(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(11)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)


def awkward_directions() -> torch.Tensor:
    """Poles, axes, directions next to a pole, and random ones."""
    special = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-9, 1e-9, 1], [1e-3, -1e-3, 1 - 1e-6]]
    axes = torch.nn.functional.normalize(torch.tensor(special, dtype=torch.float64), dim=-1)
    return torch.cat([axes, random_directions(40)])


def test_the_first_four_are_literals() -> None:
    directions = awkward_directions()
    values = real_spherical_harmonics(1, directions)
    x, y, z = directions.unbind(dim=-1)
    expected = torch.stack([torch.full_like(x, 0.28209479177387814), *(0.4886025119029199 * c for c in (y, z, x))], -1)
    assert_close(values, expected, rtol=1e-15, atol=1e-16)
    assert_close(0.4886025119029199, math.sqrt(3 / (4 * math.pi)))


def test_degree_two_literals() -> None:
    directions = random_directions(20)
    x, y, z = directions.unbind(dim=-1)
    a, b, c = math.sqrt(15 / (4 * math.pi)), math.sqrt(5 / (16 * math.pi)), math.sqrt(15 / (16 * math.pi))
    expected = torch.stack([a * x * y, a * y * z, b * (3 * z * z - 1), a * x * z, c * (x * x - y * y)], dim=-1)
    assert_close(real_spherical_harmonics(2, directions)[:, 4:], expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("degree", [0, 5, 64])
def test_against_scipy(degree: int) -> None:
    directions = awkward_directions()
    theta, phi = (angle.numpy() for angle in to_angles(directions))
    columns = []
    for l in range(degree + 1):
        for m in range(-l, l + 1):
            phase = (-1) ** m * math.sqrt(2)  # scipy's functions are complex and carry the Condon-Shortley phase
            complex_value = np.asarray(sph_harm_y(l, abs(m), theta, phi))
            part = np.imag(complex_value) if m < 0 else np.real(complex_value)
            columns.append(torch.from_numpy(part * (phase if m else 1.0)))
    # Near the poles scipy works from rounded angles: 64 times their rounding error.
    assert_close(real_spherical_harmonics(degree, directions), torch.stack(columns, -1), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(("lowest", "degree"), [(0, 3), (0, 16), (57, 64)])
def test_gram_matrix_is_the_identity(lowest: int, degree: int) -> None:
    """Gauss-Legendre in z times equal azimuths integrates products up to degree 2L exactly."""
    heights, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(degree + 1))
    azimuths = 2 * math.pi * torch.arange(2 * degree + 2, dtype=torch.float64) / (2 * degree + 2)
    directions = from_angles(torch.arccos(heights)[:, None], azimuths)
    values = real_spherical_harmonics(degree, directions).flatten(0, 1)[:, lowest**2 :]
    weight = weights.repeat_interleave(len(azimuths)) * (2 * math.pi / len(azimuths))
    gram = values.T @ (weight[:, None] * values)
    assert_close(gram, torch.eye(values.shape[1], dtype=torch.float64), rtol=0, atol=1e-12)


def test_addition_theorem() -> None:
    degree = 64
    first, second = awkward_directions(), random_directions(46).flip(0)
    product = real_spherical_harmonics(degree, first) * real_spherical_harmonics(degree, second)
    cosine = (first * second).sum(dim=-1).numpy()
    for l in (0, 1, 2, 17, 64):
        expected = torch.from_numpy((2 * l + 1) / (4 * math.pi) * eval_legendre(l, cosine))
        assert_close(product[:, l * l : (l + 1) ** 2].sum(dim=-1), expected, rtol=0, atol=1e-12)


def test_at_the_poles_only_zonal_functions_remain() -> None:
    values = real_spherical_harmonics(64, torch.tensor([[0, 0, 1.0], [0, 0, -1.0]], dtype=torch.float64))
    l = torch.arange(65, dtype=torch.float64)
    expected = torch.zeros_like(values)
    expected[:, (l * (l + 1)).long()] = torch.sqrt((2 * l + 1) / (4 * math.pi))
    expected[1, (l * (l + 1)).long()] *= (-1) ** l
    assert_close(values, expected, rtol=1e-12, atol=0)


def test_a_turn_about_z_mixes_each_pair_by_its_order() -> None:
    theta, phi = to_angles(random_directions(10))
    turned = real_spherical_harmonics(6, from_angles(theta, phi + 0.3))
    values = real_spherical_harmonics(6, from_angles(theta, phi))
    for l in range(7):
        for m in range(1, l + 1):
            plus, minus = values[:, l * (l + 1) + m], values[:, l * (l + 1) - m]
            assert_close(turned[:, l * (l + 1) + m], math.cos(0.3 * m) * plus - math.sin(0.3 * m) * minus)
            assert_close(turned[:, l * (l + 1) - m], math.sin(0.3 * m) * plus + math.cos(0.3 * m) * minus)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batch_axes_and_dtype(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    directions = torch.nn.functional.normalize(torch.rand(*batch, 3, dtype=dtype), dim=-1)
    values = real_spherical_harmonics(3, directions)
    assert values.dtype == dtype
    assert_close(values.reshape(-1, 16), real_spherical_harmonics(3, directions.reshape(-1, 3)))
    assert values.shape == (*batch, 16)
