"""How far a light can be trusted: against the whole singular value decomposition, and against many photographs."""

from __future__ import annotations

import math

import pytest
import torch
from shadows import BLOCK, RECEIVER, block_transfer, coarsened, patchy, whole
from torch.testing import assert_close

from torchlight.analysis.confidence import Confidence, Found, at_pixels, confidence, square_means, wavelets_at
from torchlight.analysis.equations import Equations
from torchlight.analysis.observability import observability, whitened
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.linear import solve
from torchlight.inversion.quadtree import quadtree
from torchlight.inversion.refinement import needed
from torchlight.light import haar, latlong
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.photo.observation import Observation
from torchlight.pipeline import estimate, with_confidence
from torchlight.results import select
from torchlight.solvers import NNLS, NonnegativeSynthesis, ProjectedAdam, Ridge, Solver
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer

POINTS = RECEIVER.points


def weights(share: float, seed: int = 0) -> torch.Tensor:
    return (torch.rand(POINTS, generator=torch.Generator().manual_seed(seed)) < share).double()


@pytest.mark.parametrize("share", [1.0, 0.9, 0.3])
def test_inner_products_under_weights(share: float) -> None:
    columns = block_transfer(8).transport.T.contiguous()
    used = weights(share) * torch.linspace(0.5, 1, POINTS, dtype=torch.float64)
    used[::7] = 1.0
    equations = Equations(columns)
    for chosen in (used, torch.ones_like(used), used):
        assert_close(equations.gram(chosen), (columns * chosen) @ columns.T, rtol=1e-10, atol=1e-12)


def found_by(transfer: Transfer, basis: Basis, solver: Solver, noise: float = 0.01) -> Found:
    light = torch.rand(3, transfer.transport.shape[1], generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    samples = light @ transfer.transport.T
    used = weights(0.9)
    seen = Observation(samples, used)
    synthesis = basis.synthesis_matrix() if isinstance(solver, NonnegativeSynthesis) else None
    on_texels = isinstance(basis, HaarCubemap) and not isinstance(solver, Ridge)
    matrix = transfer.transport if on_texels else transfer.project(basis)
    coefficients = solve(matrix, seen, solver, synthesis).coefficients
    predicted = coefficients @ matrix.T
    coefficients = basis.analysis(coefficients) if on_texels else coefficients
    return Found(seen, predicted, basis, solver, coefficients, None, noise)


@pytest.mark.parametrize("noise", [0.01, 0.0016])
def test_observability_is_that_of_the_analysis(noise: float) -> None:
    transfer = block_transfer(8)
    found = found_by(transfer, Texels(8), NNLS(), noise)
    expected = observability(whitened(transfer, found.received.weights > 0, noise))
    told = confidence(transfer, found)
    assert_close(told.observability.double(), expected.diagonal, rtol=0, atol=1e-6)
    assert told.determined_share == pytest.approx(expected.share(expected.determined))
    assert told.degrees_of_freedom == pytest.approx(expected.degrees_of_freedom, rel=1e-6)
    assert bool(told.seen.all())


METHODS = [
    (Texels(4), NNLS()),
    (Texels(4), ProjectedAdam()),
    (Texels(4), Ridge(1e-3)),
    (HaarCubemap(4), NNLS()),
    (HaarCubemap(4), Ridge(1e-3)),
    (SphericalHarmonics(2, 4), NonnegativeSynthesis()),
    (SphericalHarmonics(2, 4), Ridge(1e-3)),
]


@pytest.mark.parametrize(("basis", "solver"), METHODS, ids=lambda value: type(value).__name__)
def test_every_method_has_deviations_in_proportion_to_the_noise(basis: Basis, solver: Solver) -> None:
    transfer = coarsened(block_transfer(8), 4)
    quiet, loud = (confidence(transfer, found_by(transfer, basis, solver, noise)) for noise in (0.001, 0.002))
    assert quiet.deviation.shape == (3, 48)
    assert bool((quiet.deviation > 0).all())
    if isinstance(solver, Ridge):  # whose prior is in proportion too
        assert_close(loud.deviation, 2 * quiet.deviation, rtol=1e-4, atol=0)
    else:
        free = found_by(transfer, basis, solver).coefficients
        assert free.isfinite().all()
        assert bool((loud.deviation >= quiet.deviation * 0.999).all())


@pytest.mark.parametrize("solver", [NNLS(), Ridge(1e-3)])
def test_a_whole_haar_basis_is_the_texels(solver: Solver) -> None:
    transfer = coarsened(block_transfer(8), 4)
    both = [confidence(transfer, found_by(transfer, basis, solver)) for basis in (Texels(4), HaarCubemap(4))]
    if isinstance(solver, Ridge):
        matrix = transfer.project(HaarCubemap(4))[found_by(transfer, Texels(4), solver).received.weights > 0]
        largest = torch.linalg.matrix_norm(matrix, 2) ** 2
        inverse = torch.linalg.inv(matrix.T @ matrix + 1e-3 * largest * torch.eye(48, dtype=torch.float64))
        synthesis = HaarCubemap(4).synthesis_matrix()
        sigma = found_by(transfer, Texels(4), solver).sigma
        expected = sigma * (synthesis @ inverse @ synthesis.T).diagonal().sqrt()
        assert_close(both[1].deviation[0].double(), expected, rtol=1e-5, atol=0)
    assert_close(both[0].deviation, both[1].deviation, rtol=1e-4, atol=0)


def test_the_squares_of_a_tree_scatter_over_photographs_as_predicted() -> None:
    """One tree, many noisy photographs: the deviation of each square's radiance against the predicted one."""
    transfer, noise, draws = block_transfer(8), 0.002, 3000
    nodes = whole(transfer)
    light = patchy(8, seed=3)
    samples = light @ transfer.transport.T
    settings = AdaptiveHaar(8, 30, noise=noise)
    clean = solve_adaptive(nodes, Observation(samples[None], torch.ones(1, POINTS, dtype=torch.float64)), settings)
    kept, coefficients = clean.refinement.kept[0], clean.solution.coefficients[0]
    used = torch.ones(POINTS, dtype=torch.float64)
    found = Found(
        Observation(samples, used), clean.irradiance[0], HaarCubemap(8), settings, coefficients, kept, noise
    )  # fmt: skip
    told = confidence(nodes, found)
    tree = quadtree(8)
    leaves = tree.leaves(needed(tree, kept[0]))
    values = square_means(tree, haar.synthesis(coefficients, 8), leaves)[0]
    predicted = square_means(tree, told.deviation.double(), leaves)[0]
    columns = nodes.of(leaves).T
    shown = columns @ values
    generator = torch.Generator().manual_seed(5)
    drawn = shown + found.sigma * torch.randn(draws, 1, POINTS, generator=generator, dtype=torch.float64)
    again = solve(columns, Observation(drawn, torch.ones(draws, POINTS, dtype=torch.float64)), NNLS()).coefficients
    clear = values > 6 * predicted
    assert int(clear.sum()) >= 10
    ratio = again[:, 0].std(dim=0)[clear] / predicted[clear]
    assert_close(ratio.median().item(), 1.0, rtol=0, atol=0.05)
    assert_close(
        ratio, torch.ones_like(ratio), rtol=0, atol=0.25
    )  # neighbours are at 0 in some draws and not in others


def test_where_no_square_comes_near_zero_the_scatter_is_exact() -> None:
    transfer, noise, draws = block_transfer(8), 0.0005, 4000
    nodes = whole(transfer)
    light = torch.ones(1, 192, dtype=torch.float64)
    light[:, -20:] = 3.0
    samples = light @ transfer.transport.T
    settings = AdaptiveHaar(8, 15, noise=noise)
    observation = Observation(samples[None], torch.ones(1, POINTS, dtype=torch.float64))
    clean = solve_adaptive(nodes, observation, settings)
    kept, coefficients = clean.refinement.kept[0], clean.solution.coefficients[0]
    seen = Observation(samples, torch.ones(POINTS, dtype=torch.float64))
    found = Found(seen, clean.irradiance[0], HaarCubemap(8), settings, coefficients, kept, noise)
    tree = quadtree(8)
    leaves = tree.leaves(needed(tree, kept[0]))
    predicted = square_means(tree, confidence(nodes, found).deviation.double(), leaves)[0]
    values = square_means(tree, haar.synthesis(coefficients, 8), leaves)[0]
    assert bool((values > 5 * predicted).all())
    columns = nodes.of(leaves).T
    generator = torch.Generator().manual_seed(6)
    drawn = columns @ values + found.sigma * torch.randn(draws, 1, POINTS, generator=generator, dtype=torch.float64)
    again = solve(columns, Observation(drawn, torch.ones(draws, POINTS, dtype=torch.float64)), NNLS()).coefficients
    ratio = again[:, 0].std(dim=0) / predicted
    assert_close(ratio, torch.ones_like(ratio), rtol=0, atol=4.5 / math.sqrt(2 * draws))


def test_the_papers_rule_counts_only_the_wavelets_it_keeps() -> None:
    transfer = block_transfer(8)
    nodes = whole(transfer)
    samples = patchy(8, seed=1) @ transfer.transport.T
    settings = AdaptiveHaar(8, 40, noise=0.002, rule=LevelByLevel())
    observation = Observation(samples[None], torch.ones(1, POINTS, dtype=torch.float64))
    clean = solve_adaptive(nodes, observation, settings)
    kept = clean.refinement.kept[0]
    seen = Observation(samples, torch.ones(POINTS, dtype=torch.float64))
    found = Found(seen, clean.irradiance[0], HaarCubemap(8), settings, clean.solution.coefficients[0], kept, 0.002)
    told = confidence(nodes, found).deviation[0].double()
    texels = haar.synthesis(clean.solution.coefficients[0], 8)[0]
    functions = HaarCubemap(8).synthesis_matrix()[:, kept[0]]
    held = texels <= 1e-6 * texels.max()
    _, values, right = torch.linalg.svd(functions[held], full_matrices=True)
    free = right[int((values > 1e-9).sum()) :].T
    rows = transfer.transport @ functions @ free
    covariance = found.sigma**2 * functions @ free @ torch.linalg.inv(rows.T @ rows) @ (functions @ free).T
    assert_close(told[~held], covariance.diagonal().sqrt()[~held], rtol=1e-4, atol=0)
    assert kept[0].sum() < 40 + 1


def test_wavelets_on_squares() -> None:
    tree = quadtree(4)
    kept = torch.ones(48, dtype=torch.bool)
    leaves = tree.leaves(torch.ones(tree.supports.shape[0], dtype=torch.bool))
    order = square_means(tree, torch.eye(48, dtype=torch.float64), leaves)
    assert_close(wavelets_at(tree, leaves, kept), order.T @ HaarCubemap(4).synthesis_matrix(), rtol=0, atol=1e-12)


def test_maps_are_those_of_the_texel_that_holds_a_pixels_centre() -> None:
    values = torch.arange(48.0)
    shown = at_pixels(values, 4, 16, -1.0)
    upper = latlong.pixel_directions(16)[:8]
    brightest = upper.reshape(-1, 3)[:, 2].argmax()
    assert bool((shown[8:] == -1).all())
    assert bool((shown[:8] >= 0).all())
    assert 32 <= shown[:8].reshape(-1)[brightest] < 48  # the top face comes last


def test_what_no_sample_sees_is_infinitely_uncertain() -> None:
    matrix = torch.eye(48, dtype=torch.float64)[:40]
    transfer = Transfer(matrix, 4)
    samples = torch.ones(1, 40, dtype=torch.float64)
    light = torch.ones(1, 48, dtype=torch.float64) * torch.cat([torch.ones(40), torch.zeros(8)]).double()
    found = Found(
        Observation(samples, torch.ones(40, dtype=torch.float64)), samples, Texels(4), NNLS(), light, None, 0.01
    )  # fmt: skip
    told = confidence(transfer, found)
    assert_close(told.deviation[0, :40], torch.full((40,), 0.01), rtol=1e-5, atol=0)
    assert bool(told.deviation[0, 40:].isinf().all())
    assert told.seen.tolist() == [True] * 40 + [False] * 8
    assert told.observability[40:].tolist() == [0.0] * 8
    assert int(told.unseen_map(64)[:32].sum()) > 0
    assert bool(told.unseen_map(64)[32:].all())
    assert bool(told.deviation_map(64)[:, 32:].isinf().all())


def test_an_estimate_carries_its_confidence() -> None:
    scene = block_scene(BLOCK, RECEIVER)
    transfer = Transfer(block_transfer(8).transport.float(), 8)
    photo = (patchy(8, 2, 3) @ block_transfer(8).transport.T / torch.pi).reshape(3, 20, 20).flip(1).float()
    for settings in (AdaptiveHaar(8, 40), None):
        basis = None if settings is not None else Texels(8)
        found = select(estimate(photo[None], scene, basis, settings, transfer), 0)
        assert found.confidence is None
        told = with_confidence(found, scene, transfer, settings).confidence
        assert isinstance(told, Confidence)
        assert told.deviation.shape == (3, 192)
        assert told.noise >= 0.999 * 0.4 / 255
        assert with_confidence(found, scene, transfer).confidence is not None
