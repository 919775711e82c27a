"""Haar wavelets of a plane's cube map: orthonormality, constants, supports, the fast projection."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import cubemap, haar

RESOLUTIONS = [2, 4, 8, 16]


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def basis_functions(resolution: int) -> torch.Tensor:
    """Every basis function on the five faces, from its support alone: [coeffs, 5, N, N]."""
    supports = haar.supports(resolution)
    functions = torch.zeros(len(supports.kind), 5, resolution, resolution, dtype=torch.float64)
    table = zip(*(getattr(supports, name).tolist() for name in ("face", "level", "row", "column", "kind")), strict=True)
    for function, (face, level, row, column, kind) in zip(functions, table, strict=True):
        side = resolution // 2**level
        square = torch.full((side, side), float(2**level), dtype=torch.float64)  # 1 / sqrt(area of the support)
        if kind in (haar.HORIZONTAL, haar.DIAGONAL):
            square[:, side // 2 :] *= -1
        if kind in (haar.VERTICAL, haar.DIAGONAL):
            square[side // 2 :] *= -1
        function[face, row * side : (row + 1) * side, column * side : (column + 1) * side] = square
    return functions


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_synthesis_gives_the_functions_that_supports_describes(resolution: int) -> None:
    identity = torch.eye(3 * resolution**2, dtype=torch.float64)
    actual = cubemap.scatter_to_faces(haar.synthesis(identity, resolution), resolution)
    assert_close(actual, basis_functions(resolution))


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_functions_are_orthonormal_over_unit_face_area(resolution: int) -> None:
    functions = haar.synthesis(torch.eye(3 * resolution**2, dtype=torch.float64), resolution)
    assert_close(functions @ functions.T / resolution**2, torch.eye(3 * resolution**2, dtype=torch.float64))


@pytest.mark.parametrize("resolution", [*RESOLUTIONS, 32, 128])
def test_reconstruction_is_perfect_both_ways(resolution: int) -> None:
    values = random(3 * resolution**2)
    assert_close(haar.synthesis(haar.analysis(values, resolution), resolution), values)
    assert_close(haar.analysis(haar.synthesis(values, resolution), resolution), values)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_parseval_over_unit_face_area(resolution: int) -> None:
    first, second = random(2, 3 * resolution**2)
    a, b = haar.analysis(first, resolution), haar.analysis(second, resolution)
    assert_close(a @ b, first @ second / resolution**2)


@pytest.mark.parametrize("resolution", [2, 16, 128])
def test_a_constant_has_the_same_scaling_coefficients_at_any_resolution(resolution: int) -> None:
    supports = haar.supports(resolution)
    coefficients = haar.analysis(torch.full((3 * resolution**2,), 7.0, dtype=torch.float64), resolution)
    expected = torch.zeros_like(coefficients)
    expected[supports.kind == haar.SCALING] = torch.tensor([3.5] * 8 + [7.0], dtype=torch.float64)
    assert_close(coefficients, expected)


def test_coefficients_of_a_coarse_function_do_not_depend_on_the_resolution() -> None:
    coarse = random(48)
    faces = cubemap.scatter_to_faces(coarse, 4)
    fine = cubemap.gather_from_faces(faces.repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2))
    actual, expected = haar.analysis(fine, 8), haar.analysis(coarse, 4)
    keep = haar.supports(8).level < 2  # the coarse grid's wavelets; the finest have nothing to add
    assert_close(actual[keep], expected)
    assert_close(actual[~keep], torch.zeros(144, dtype=torch.float64))


@pytest.mark.parametrize(("face", "row", "column"), [(0, 0, 0), (1, 3, 5), (3, 2, 4), (4, 0, 7), (4, 7, 3)])
def test_one_texel_touches_one_trio_per_level(face: int, row: int, column: int) -> None:
    resolution, levels = 8, 3
    faces = torch.zeros(5, resolution, resolution, dtype=torch.float64)
    faces[face, row, column] = 1.0
    coefficients = haar.analysis(cubemap.gather_from_faces(faces), resolution)
    supports = haar.supports(resolution)
    shift = levels - supports.level
    covers = (supports.face == face) & (row >> shift == supports.row) & (column >> shift == supports.column)
    assert_close(coefficients.nonzero()[:, 0], covers.nonzero()[:, 0])
    # <texel, function> = function value / N^2, and a function on a support of area 4^-j has the magnitude 2^j.
    assert_close(coefficients[covers].abs(), 2.0 ** supports.level[covers].double() / resolution**2)
    assert int(covers.sum()) == (1 + 3 * levels if face == cubemap.TOP_FACE else 1 + 3 * (levels - 1))


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_functions_stay_independent_above_the_horizon(resolution: int) -> None:
    """No two coarsest functions are collinear: the smallest singular value of the synthesis is N, as is the largest."""
    matrix = haar.synthesis(torch.eye(3 * resolution**2, dtype=torch.float64), resolution)
    singular = torch.linalg.svdvals(matrix)
    assert_close(singular, torch.full_like(singular, resolution))


def test_a_left_bright_top_face_has_a_positive_horizontal_coefficient() -> None:
    faces = torch.zeros(5, 2, 2, dtype=torch.float64)
    faces[4] = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    coefficients = haar.analysis(cubemap.gather_from_faces(faces), 2)
    assert_close(coefficients, torch.tensor([0.0] * 8 + [0.5, 0.5, 0.0, 0.0], dtype=torch.float64))


def test_supports_of_the_smallest_map() -> None:
    supports = haar.supports(2)
    assert supports.root.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 8]
    assert supports.face.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4, 4]
    assert supports.level.tolist() == [1] * 8 + [0] * 4
    assert supports.row.tolist() == [0] * 12
    assert supports.column.tolist() == [0, 1] * 4 + [0] * 4
    assert supports.kind.tolist() == [0] * 9 + [1, 2, 3]


@pytest.mark.parametrize("resolution", [4, 16])
def test_supports_count_three_wavelets_for_each_of_the_visible_squares(resolution: int) -> None:
    supports = haar.supports(resolution)
    wavelet = supports.kind != haar.SCALING
    for level in range(round(math.log2(resolution))):
        for face in range(5):
            squares = 4**level if face == cubemap.TOP_FACE else 4**level // 2
            found = wavelet & (supports.level == level) & (supports.face == face)
            assert int(found.sum()) == (3 * squares if squares > 1 or face == cubemap.TOP_FACE else 0)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_projection_is_the_product_with_the_functions(resolution: int, batch: tuple[int, ...]) -> None:
    transport = random(*batch, 3 * resolution**2)
    columns = haar.synthesis(torch.eye(3 * resolution**2, dtype=torch.float64), resolution).T
    assert_close(haar.project(transport, resolution), transport @ columns, rtol=1e-12, atol=1e-12)


def test_projection_is_the_adjoint_of_synthesis() -> None:
    transport, coefficients = random(2, 768)
    predicted = haar.project(transport, 16) @ coefficients
    assert_close(predicted, transport @ haar.synthesis(coefficients, 16), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("side", [1, 2, 8])
def test_block_transform_is_orthogonal(side: int) -> None:
    blocks = random(3, 2, side, side)
    coefficients = haar.block_analysis(blocks)
    assert_close(coefficients.square().sum(dim=-1), blocks.square().sum(dim=(-1, -2)))
    assert_close(haar.block_synthesis(coefficients), blocks)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batch_axes_and_dtype(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    values = torch.rand(*batch, 48, dtype=dtype)
    for transform in (haar.analysis, haar.synthesis, haar.project):
        result = transform(values, 4)
        assert result.dtype == dtype
        one_by_one = torch.stack([transform(row, 4) for row in values.reshape(-1, 48)])
        assert_close(result.reshape(-1, 48), one_by_one)
        assert result.shape == (*batch, 48)


@pytest.mark.parametrize("resolution", [0, 1, 3, 12, -4])
def test_resolutions_that_do_not_halve_are_refused(resolution: int) -> None:
    with pytest.raises(ConfigError, match=f"power of two from 2, got {resolution};"):
        haar.supports(resolution)
    with pytest.raises(ConfigError, match="power of two"):
        haar.analysis(torch.zeros(48), resolution)


def test_the_wrong_number_of_texels_is_refused() -> None:
    with pytest.raises(ShapeError, match="resolution 4 has 48 visible texels, got 12"):
        haar.synthesis(torch.zeros(12), 4)
