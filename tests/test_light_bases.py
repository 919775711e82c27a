"""The bases: one set of laws for all, then what each is exact for."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from scipy.integrate import quad
from scipy.special import eval_legendre
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light import cubemap
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.light.harmonics import real_spherical_harmonics

BASES: list[Basis] = [Texels(1), Texels(8), SphericalHarmonics(3, 1), SphericalHarmonics(5, 8), HaarCubemap(8)]


def random(*shape: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64).to(dtype)


def matrix(basis: Basis) -> torch.Tensor:
    """S, written out where the basis leaves it out."""
    dense = basis.synthesis_matrix()
    return torch.eye(basis.size, dtype=torch.float64) if dense is None else dense


# --- laws ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", BASES, ids=str)
def test_projection_equals_the_dense_product(basis: Basis) -> None:
    transport = random(7, cubemap.texel_count(basis.resolution))
    assert_close(basis.project(transport), transport @ matrix(basis), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("basis", BASES, ids=str)
def test_synthesis_equals_the_dense_product(basis: Basis) -> None:
    coefficients = random(7, basis.size)
    assert_close(basis.synthesis(coefficients), coefficients @ matrix(basis).T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("basis", BASES, ids=str)
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batch_axes_and_dtype(basis: Basis, batch: tuple[int, ...], dtype: torch.dtype) -> None:
    texels = cubemap.texel_count(basis.resolution)
    calls = ((basis.analysis, texels), (basis.project, texels), (basis.synthesis, basis.size))
    for call, length in calls:
        values = random(*batch, length, dtype=dtype)
        result = call(values)
        assert result.dtype == dtype
        assert result.shape[:-1] == batch
        reference = torch.stack([call(row) for row in values.double().reshape(-1, length)]).reshape(result.shape)
        # float32: a few hundred products of size 1 to N
        tolerance = 1e-3 if dtype == torch.float32 else 1e-12
        assert_close(result.double(), reference, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("basis", BASES, ids=str)
def test_bases_are_settings(basis: Basis) -> None:
    assert hash(basis) == hash(dataclasses.replace(basis))  # pyright: ignore[reportArgumentType]
    assert basis.synthesis(torch.zeros(basis.size)).shape == (cubemap.texel_count(basis.resolution),)


def test_names_sizes_and_signs() -> None:
    described = [(b.name, b.size, b.resolution, b.nonnegative_coefficients) for b in BASES]
    assert described == [
        ("texels", 5, 1, True),
        ("texels", 192, 8, True),
        ("sh", 16, 1, False),
        ("sh", 36, 8, False),
        ("haar", 192, 8, False),
    ]


def test_synthesis_matrices_follow_dtype() -> None:
    for basis in (SphericalHarmonics(2, 2), HaarCubemap(2)):
        dense = basis.synthesis_matrix(dtype=torch.float32)
        assert dense.dtype == torch.float32
        assert_close(dense.double(), basis.synthesis_matrix(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("resolution", [0, -2, 3, 12, 1024])
@pytest.mark.parametrize("make", [Texels, HaarCubemap, lambda n: SphericalHarmonics(4, n)])
def test_odd_resolutions_are_refused_in_one_line(make: type[Texels], resolution: int) -> None:
    with pytest.raises(ConfigError, match=rf"^resolution: expected a power of two from \d to 512, got {resolution};"):
        make(resolution)


def test_haar_refuses_a_single_texel() -> None:
    with pytest.raises(ConfigError, match="power of two from 2 to 512, got 1"):
        HaarCubemap(1)


@pytest.mark.parametrize("degree", [-1, 65])
def test_degrees_out_of_range_are_refused(degree: int) -> None:
    with pytest.raises(ConfigError, match=f"^degree: expected 0 to 64, got {degree};"):
        SphericalHarmonics(degree, 16)


# --- texels and Haar -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", [Texels(1), Texels(16), HaarCubemap(2), HaarCubemap(16)], ids=str)
def test_analysis_undoes_synthesis(basis: Basis) -> None:
    coefficients = random(basis.size)
    assert_close(basis.analysis(basis.synthesis(coefficients)), coefficients)


@pytest.mark.parametrize("basis", [Texels(4), SphericalHarmonics(2, 4), HaarCubemap(4)], ids=str)
def test_constant_light_on_the_open_plane_gives_pi(basis: Basis) -> None:
    """E = pi L through every basis; a constant is in the span of each."""
    transport = cubemap.cosine_weights(basis.resolution, 1)[:, 0]
    coefficients = torch.zeros(basis.size, dtype=torch.float64)
    if basis.name == "texels":
        coefficients[:] = 2.0
    elif basis.name == "sh":
        coefficients[0] = 2.0 * math.sqrt(4 * math.pi)
    else:
        coefficients[[0, 4, 8, 12, 16, 20, 24, 28]] = 1.0
        coefficients[32] = 2.0
    assert_close(basis.synthesis(coefficients), torch.full((48,), 2.0, dtype=torch.float64))
    assert_close((basis.project(transport) @ coefficients).item(), 2 * math.pi, rtol=1e-13, atol=0)


# --- spherical harmonics -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("degree", "resolution"), [(2, 1), (8, 1), (4, 2), (16, 4), (5, 16), (64, 2)])
def test_open_plane_has_the_clamped_cosines_coefficients(degree: int, resolution: int) -> None:
    """Funk-Hecke: integral of max(0, z) Y_l0 = A_l sqrt((2l + 1) / 4 pi), A = pi, 2 pi/3, pi/4, 0, -pi/24, 0, ..."""
    transport = cubemap.cosine_weights(resolution, 1)[:, 0]
    actual = SphericalHarmonics(degree, resolution).project(transport)
    expected = torch.zeros_like(actual)
    for l in range(degree + 1):
        expected[l * (l + 1)] = clamped_cosine(l) * math.sqrt((2 * l + 1) / (4 * math.pi))
    assert_close(actual, expected, rtol=0, atol=1e-12)


def clamped_cosine(l: int) -> float:
    """2 pi times the integral over [0, 1] of t P_l(t): Ramamoorthi and Hanrahan 2001, eq. 19."""
    if l == 1:
        return 2 * math.pi / 3
    if l % 2:
        return 0.0
    half = l // 2
    return 2 * math.pi * (-1) ** (half + 1) / ((l + 2) * (l - 1)) * math.comb(l, half) / 2**l


def test_clamped_cosine_literals() -> None:
    actual = [clamped_cosine(l) for l in range(5)]
    assert_close(actual, [math.pi, 2 * math.pi / 3, math.pi / 4, 0.0, -math.pi / 24])
    for l in range(65):
        expected, _ = quad(lambda t, l=l: 2 * math.pi * t * eval_legendre(l, t), 0, 1, epsabs=1e-13)
        assert_close(clamped_cosine(l), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("degree", "resolution"), [(4, 1), (5, 4)])
def test_texel_averages_against_fine_cells(degree: int, resolution: int) -> None:
    """An independent rule: exact cosine weights of 32 x 32 cells, harmonics at their centres (second order)."""
    directions, _ = cubemap.texel_subdirections(resolution, 32)
    weights = cubemap.cosine_weights(resolution, 32)
    values = real_spherical_harmonics(degree, directions)
    expected = torch.einsum("tc,tcb->tb", weights, values) / weights.sum(dim=-1, keepdim=True)
    actual = SphericalHarmonics(degree, resolution).synthesis_matrix()
    assert_close(actual, expected, rtol=0, atol=2e-3 / resolution**2)


def test_averages_of_the_constant_are_exact() -> None:
    column = SphericalHarmonics(6, 4).synthesis_matrix()[:, 0]
    assert_close(column, torch.full_like(column, math.sqrt(1 / (4 * math.pi))), rtol=1e-15, atol=0)


def test_analysis_of_a_hemisphere_of_light() -> None:
    """L = 1 above the plane: c_00 = sqrt(pi), c_10 = sqrt(3 pi) / 2, no other term below degree 3."""
    expected = torch.zeros(9, dtype=torch.float64)
    expected[0], expected[2] = math.sqrt(math.pi), math.sqrt(3 * math.pi) / 2
    for resolution in (1, 4):
        texels = torch.ones(cubemap.texel_count(resolution), dtype=torch.float64)
        assert_close(SphericalHarmonics(2, resolution).analysis(texels), expected, rtol=0, atol=1e-12)


def test_analysis_approaches_the_integral_of_a_smooth_light() -> None:
    """L = z above the plane has the clamped cosine's coefficients; texels bring a second-order error."""
    resolution, degree = 32, 4
    directions = cubemap.texel_directions(resolution, 5)[cubemap.visible_texels(resolution)]
    actual = SphericalHarmonics(degree, resolution).analysis(directions[:, 2])
    expected = torch.zeros_like(actual)
    for l in range(degree + 1):
        expected[l * (l + 1)] = clamped_cosine(l) * math.sqrt((2 * l + 1) / (4 * math.pi))
    assert_close(actual, expected, rtol=0, atol=1e-3)
