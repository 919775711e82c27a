"""The transport: closed forms, laws, and a block's analytic shadow under light the transport never saw."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight import transfer
from torchlight.errors import ConfigError, ShapeError
from torchlight.geometry import primitives
from torchlight.geometry.analytic_shadow import Block, block_irradiance
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light import cubemap
from torchlight.light.bases import HaarCubemap, SphericalHarmonics, Texels
from torchlight.transfer import Transfer, directions_of, square_columns, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (12, 12))
BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2))
EMPTY = torch.zeros(0, 3, 3, dtype=torch.float64)


def box(size: tuple[float, float, float], turn: float = 0.0, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Tensor:
    return transform(primitives.box(size), 1.0, (0.0, 0.0, turn), (x, y, z))


def block_triangles() -> Tensor:
    return box(BLOCK.size, BLOCK.rotation_degrees, *BLOCK.translation)


def block_transfer(receiver: Receiver = RECEIVER, resolution: int = 8, subsamples: int = 6) -> Transfer:
    return transport(Scene(block_triangles(), receiver), resolution, subsamples)


def heavy_tailed(resolution: int, seed: int) -> Tensor:
    """Radiance of the visible texels in three channels, the brightest some hundred times the median."""
    generator = torch.Generator().manual_seed(seed)
    count = cubemap.texel_count(resolution)
    return torch.exp(2 * torch.randn(3, count, generator=generator, dtype=torch.float64))


def split_texels(radiance: Tensor, resolution: int, cells: int) -> tuple[Tensor, Tensor]:
    """Directions and fluxes of light that is constant over texels, on another grid than the transport's."""
    parts = cubemap.texel_cells(resolution, cells)
    weights = cubemap.cell_cosine_weights(parts)
    fluxes = radiance.T[:, None, :] * weights[..., None]
    return cubemap.cell_directions(parts).reshape(-1, 3), fluxes.reshape(-1, radiance.shape[0])


# --- closed forms --------------------------------------------------------------------------------------------------


def test_an_unoccluded_plane_under_constant_light_has_pi_l() -> None:
    """At the default sampling; the cosine integral alone is exact to rounding."""
    scene = Scene(EMPTY, Receiver((0.0, 0.0), (2.0, 1.0), (2, 1)))
    found = transport(scene, 16, 12).mv(torch.full((768,), 0.7))
    assert_close(found, torch.full_like(found, 0.7 * math.pi), rtol=1e-3, atol=0)
    weights = cubemap.cell_cosine_weights(cubemap.texel_cells(16, 12)).sum()
    assert_close(weights, torch.tensor(math.pi, dtype=torch.float64), rtol=1e-12, atol=0)


def test_without_occluders_each_column_is_the_texel_s_own_integral() -> None:
    found = transport(Scene(EMPTY, RECEIVER), 8, 3).transport
    expected = cubemap.cosine_weights(8, 1)[:, 0].float()
    assert_close(found, expected.expand_as(found), rtol=1e-6, atol=0)


def test_a_fully_covered_plane_is_black() -> None:
    found = transport(Scene(box((40.0, 40.0, 1.0)), RECEIVER), 8, 4).transport
    assert torch.equal(found, torch.zeros_like(found))


def test_a_far_wide_plate_leaves_the_light_beside_it() -> None:
    """A square plate of side 2 at height 1 over a point hides a view factor known in closed form."""
    scene = Scene(box((2.0, 2.0, 1e-4), z=1.0), Receiver((0.0, 0.0), (1e-3, 1e-3), (1, 1)))
    found = transport(scene, 16, 12).mv(torch.ones(768)) / math.pi
    root = math.sqrt(2)
    hidden = 4 * (2 / (2 * math.pi) * (1 / root * math.atan(1 / root)))
    # the plate's edge runs along cell edges of the cube map's top face: half a cell of 1/192 either way
    assert_close(found, torch.tensor([1 - hidden], dtype=torch.float32), rtol=0, atol=4e-3)


def test_a_plate_at_height_h_has_its_shifted_rectangle() -> None:
    """Each texel's share of a plate's shadow, from exact overlaps of a shifted rectangle with the footprints."""
    height, half, center = 0.7, (0.8, 0.5), (0.1, -0.2)
    scene = Scene(box((1.6, 1.0, 1e-6), x=0.1, y=-0.2, z=height), RECEIVER)
    found = transport(scene, 4, 24).mv(torch.eye(48))
    cells = cubemap.texel_cells(4, 31)
    weights = cubemap.cell_cosine_weights(cells)
    directions = cubemap.cell_directions(cells)
    slope = directions[..., :2] / directions[..., 2:]
    edges = torch.linspace(-2, 2, 13, dtype=torch.float64)
    shares = []
    for axis in (0, 1):
        middle = center[axis] - height * slope[..., axis, None]
        low, high = middle - half[axis], middle + half[axis]
        overlap = torch.minimum(high, edges[1:]) - torch.maximum(low, edges[:-1])
        shares.append(overlap.clamp(min=0) / (4 / 12))
    lit = 1 - shares[1][..., :, None] * shares[0][..., None, :]
    expected = (weights[..., None, None] * lit).sum(dim=1).flatten(start_dim=1).float()
    largest = cubemap.cosine_weights(4, 1).max().item()
    # where the edge runs along the strata a whole row of 24 rays changes sides at once
    assert_close(found / largest, expected / largest, rtol=0, atol=1 / 24)
    assert_close(found.sum(dim=0), expected.sum(dim=0), rtol=0, atol=0.01)
    assert expected.min() < 0.5 * expected.max()


# --- laws ----------------------------------------------------------------------------------------------------------


def test_light_superposes_and_the_adjoint_belongs_to_it() -> None:
    operator = block_transfer().to(dtype=torch.float64)
    generator = torch.Generator().manual_seed(1)
    light = torch.randn(2, 3, 192, generator=generator, dtype=torch.float64)
    samples = torch.randn(2, 3, 144, generator=generator, dtype=torch.float64)
    assert_close(operator.mv(2 * light[0] - 3 * light[1]), 2 * operator.mv(light[0]) - 3 * operator.mv(light[1]))
    forth, back = (operator.mv(light) * samples).sum(dim=-1), (light * operator.rmv(samples)).sum(dim=-1)
    assert_close(forth, back, rtol=1e-11, atol=0)
    assert operator.mv(light).shape == (2, 3, 144)


def test_an_added_occluder_never_brightens() -> None:
    alone = block_transfer().transport
    both = transport(
        Scene(torch.cat([block_triangles(), box((0.5, 0.5, 0.5), 30.0, -1.0, 0.5)]), RECEIVER), 8, 6
    ).transport
    assert (both <= alone).all()
    assert (both < alone).any()


def test_disjoint_shadows_add() -> None:
    """Light is hidden by one occluder, the other, or both: hidden(A or B) = hidden(A) + hidden(B) - hidden(A and B)."""
    second = box((0.5, 0.5, 0.5), 30.0, -1.2, 0.7)
    clear = transport(Scene(EMPTY, RECEIVER), 8, 6).transport
    one, two, both = (
        clear - transport(Scene(part, RECEIVER), 8, 6).transport
        for part in (block_triangles(), second, torch.cat([block_triangles(), second]))
    )
    assert (both <= one + two + 1e-6).all()
    assert (both >= torch.maximum(one, two) - 1e-6).all()
    # cells of different rays may be hidden in the same texel: equality holds where only one casts a shadow
    single = (one == 0) | (two == 0)
    assert single.float().mean() > 0.9
    assert_close(both[single], (one + two)[single], rtol=0, atol=1e-6)


@pytest.mark.parametrize("scale", [1000.0, 1e-3])
def test_the_scene_s_unit_does_not_matter(scale: float) -> None:
    """E changes by less than 1e-5 of pi."""
    size, samples = RECEIVER.size, RECEIVER.samples
    scaled = Receiver((0.0, 0.0), (size[0] * scale, size[1] * scale), samples)
    ones = torch.ones(192, dtype=torch.float64)
    expected = block_transfer().to(dtype=torch.float64).mv(ones)
    found = transport(Scene(block_triangles() * scale, scaled), 8, 6).to(dtype=torch.float64).mv(ones)
    assert_close(found / math.pi, expected / math.pi, rtol=0, atol=1e-5)


def test_rows_never_exceed_the_unoccluded_plane() -> None:
    operator = block_transfer().transport
    assert (operator >= 0).all()
    clear = cubemap.cosine_weights(8, 1)[:, 0].float()
    assert (operator <= clear * (1 + 1e-6)).all()


# --- against the analytic shadow -----------------------------------------------------------------------------------


def test_a_block_has_its_analytic_irradiance() -> None:
    """Against the analytic shadow, on 13 x 13 directions per texel and their lines against the solver's 12 x 12.

    Under heavy-tailed light, in 255ths of the brightest value; the limit is twice the largest of six seeds.
    """
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (16, 16))
    radiance = heavy_tailed(8, seed=4)
    found = block_transfer(receiver, 8, 12).to(dtype=torch.float64).mv(radiance)
    expected = block_irradiance(BLOCK, *split_texels(radiance, 8, 13), receiver, lines=2)
    difference = 255 * (found - expected) / expected.max()
    assert_close(difference.square().mean().sqrt().item(), 0.0, rtol=0, atol=0.18)
    assert expected.amin() < 0.1 * expected.amax()


def test_columns_are_analytic_where_both_take_the_same_directions() -> None:
    """On 50 lines per sample each, so that where they lie matters little: every texel, every sample."""
    receiver = Receiver((0.1, 0.0), (3.0, 4.0), (9, 8))
    squares = random_squares(12, seed=3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transfer, "LINES", 50)
        found = square_columns(Scene(block_triangles(), receiver), squares, 4)
    parts = directions_of(cubemap.square_cells(squares), 4)
    for column, directions, weights in zip(found, parts.directions, parts.weights, strict=True):
        expected = block_irradiance(BLOCK, directions.reshape(-1, 3), weights.reshape(-1, 1), receiver, lines=50)[0]
        assert_close(column / weights.sum(), expected / weights.sum(), rtol=0, atol=2e-3)


# --- squares of any level ------------------------------------------------------------------------------------------


def random_squares(count: int, seed: int, deepest: int = 9) -> Tensor:
    """(face, level, row, column) above the horizon, on all five faces and levels 1 to `deepest`."""
    generator = torch.Generator().manual_seed(seed)
    face = torch.arange(count) % 5
    level = torch.randint(1, deepest + 1, (count,), generator=generator)
    edge = 2**level
    row, column = (torch.rand(2, count, generator=generator) * edge).long()
    return torch.stack([face, level, torch.where(face < 4, row // 2, row), column], dim=1)


def test_squares_are_the_texels_of_their_level() -> None:
    scene, index = Scene(block_triangles(), RECEIVER), cubemap.visible_texels(8)
    squares = torch.stack([index // 64, torch.full_like(index, 3), index // 8 % 8, index % 8], dim=1)
    found = square_columns(scene, squares, 3)
    assert torch.equal(found.T.float(), transport(scene, 8, 3).transport)


def test_a_square_does_not_depend_on_the_others() -> None:
    scene, squares = Scene(block_triangles(), RECEIVER), random_squares(40, seed=1)
    together = square_columns(scene, squares, 4)
    assert together.dtype == torch.float64
    order = torch.randperm(40, generator=torch.Generator().manual_seed(2))
    assert torch.equal(square_columns(scene, squares[order], 4), together[order])
    for k in (0, 7, 39):
        assert torch.equal(square_columns(scene, squares[k : k + 1], 4)[0], together[k])


def test_four_quarters_make_a_square() -> None:
    """Up to the error of 12 directions against 24 along an edge, and exactly where nothing is partly hidden."""
    scene, squares = Scene(block_triangles(), RECEIVER), random_squares(20, seed=5, deepest=6)
    whole = square_columns(scene, squares, 24)
    face, level, row, column = squares.unbind(dim=1)
    quarters = [torch.stack([face, level + 1, 2 * row + i, 2 * column + j], dim=1) for i in (0, 1) for j in (0, 1)]
    parts = torch.stack([square_columns(scene, quarter, 12) for quarter in quarters]).sum(dim=0)
    open_sky = square_columns(Scene(EMPTY, RECEIVER), squares, 1)
    assert_close(parts / open_sky, whole / open_sky, rtol=0, atol=1e-12)


def test_no_squares_give_no_columns() -> None:
    assert square_columns(Scene(EMPTY, RECEIVER), torch.zeros(0, 4, dtype=torch.long), 2).shape == (0, 144)


def test_an_open_sky_has_the_exact_cosine_of_every_square() -> None:
    squares = random_squares(50, seed=7)
    found = square_columns(Scene(box((1.0, 1.0, 1.0), z=-2.0), RECEIVER), squares, 3)
    expected = cubemap.cell_cosine_weights(cubemap.square_cells(squares))
    assert_close(found, expected[:, None].expand_as(found), rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    "square", [(5, 1, 0, 0), (-1, 1, 0, 0), (0, 2, 2, 0), (4, 2, 4, 0), (4, 2, 0, -1), (4, -1, 0, 0)]
)
def test_no_square_below_the_horizon_or_off_the_map(square: tuple[int, int, int, int]) -> None:
    with pytest.raises(ConfigError, match=r"^squares: \(face, level, row, column\) = [^\n]* is no square above"):
        square_columns(Scene(EMPTY, RECEIVER), torch.tensor([square]), 2)


# --- determinism and size ------------------------------------------------------------------------------------------


def test_two_runs_give_the_same_bits() -> None:
    assert torch.equal(block_transfer().transport, block_transfer().transport)


@pytest.mark.parametrize("directions", [1, 500, 100_000])
def test_the_size_of_the_chunks_does_not_change_a_bit(monkeypatch: pytest.MonkeyPatch, directions: int) -> None:
    expected = block_transfer(resolution=4, subsamples=6).transport
    monkeypatch.setattr(transfer, "DIRECTIONS_PER_CHUNK", directions)
    assert torch.equal(block_transfer(resolution=4, subsamples=6).transport, expected)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_the_number_of_threads_does_not_change_a_bit(monkeypatch: pytest.MonkeyPatch, threads: int) -> None:
    expected = block_transfer(subsamples=5).transport
    monkeypatch.setattr("torchlight.threads.thread_count", lambda: threads)
    assert torch.equal(block_transfer(subsamples=5).transport, expected)


def test_progress_ends_at_the_whole() -> None:
    seen: list[tuple[int, int]] = []
    transport(Scene(block_triangles(), RECEIVER), 2, 2, lambda done, work: seen.append((done, work)))
    assert seen[-1] == (12, 12)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_a_transport_beyond_the_budget_is_refused_before_any_work() -> None:
    scene = Scene(EMPTY, Receiver((0.0, 0.0), (1.0, 1.0), (1000, 1000)))
    with pytest.raises(
        ConfigError, match=r"^the transport of 1,000,000 samples x 49,152 texels needs [^\n]* --resolution$"
    ):
        transport(scene, 128, 2)


def test_no_direction_per_texel_is_refused() -> None:
    with pytest.raises(ConfigError, match="subsamples: expected at least 1"):
        transport(Scene(EMPTY, RECEIVER), 2, 0)


# --- projection ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", [Texels(4), HaarCubemap(4), SphericalHarmonics(3, 4)])
def test_projection_is_the_transport_of_each_basis_function(basis: Texels | HaarCubemap | SphericalHarmonics) -> None:
    operator = block_transfer(resolution=4, subsamples=3).to(dtype=torch.float64)
    matrix = operator.project(basis)
    assert matrix.shape == (144, basis.size)
    assert_close(matrix, operator.mv(basis.synthesis(torch.eye(basis.size, dtype=torch.float64))).T)


def test_a_basis_of_another_resolution_is_refused() -> None:
    with pytest.raises(ShapeError, match="basis resolution 8 differs from the transport's 4"):
        block_transfer(resolution=4, subsamples=1).project(Texels(8))


def test_a_transport_of_another_resolution_is_refused() -> None:
    with pytest.raises(ShapeError, match="resolution 4 has 48 visible texels, got 47"):
        Transfer(torch.zeros(3, 47), 4)
