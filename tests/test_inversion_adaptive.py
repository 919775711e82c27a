"""What holds for the adaptive method whatever the rule: radiance, fates, failures, settings."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from shadows import block_transfer, coarsened, columns_of, observed, patchy, spotty
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.inversion.adaptive import AdaptiveHaar, Rule, named_rule, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.quadtree import indicators, quadtree
from torchlight.inversion.refinement import Fate, constants, trios
from torchlight.light import haar
from torchlight.photo.observation import Observation
from torchlight.solvers import Status
from torchlight.transfer import Transfer

RULES = [ProjectedGain(), ProjectedGain(1.0, share=0.5), ProjectedGain(shared=True), LevelByLevel(), LevelByLevel(1e-3)]
RESOLVED, BELOW, ILL, UNSEEN, LIMIT = (int(fate) for fate in list(Fate)[:5])


@pytest.fixture(scope="module")
def shadow() -> Transfer:
    """A block on 20 x 20 samples, 8 x 8 texels per face."""
    return block_transfer(8)


# --- radiance ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [ProjectedGain(), LevelByLevel()])
def test_uniform_light_is_nine_constants(shadow: Transfer, rule: Rule) -> None:
    light = torch.full((1, 192), 2.5, dtype=torch.float64)
    found = solve_adaptive(shadow, observed(shadow, light), AdaptiveHaar(8, rule=rule))
    tree = quadtree(8)
    expected = torch.zeros(192, dtype=torch.float64).index_fill(0, tree.root_coefficients[:8], 1.25)
    expected[tree.root_coefficients[8]] = 2.5
    assert_close(found.solution.coefficients[0], expected, rtol=0, atol=1e-8)  # the ridge of 1e-12 moves 4e-9
    assert (found.refinement.functions.item(), found.refinement.regions.item()) == (9, 9)
    assert torch.equal(found.refinement.kept[0], constants(tree))
    assert set(found.refinement.fate.unique().tolist()) <= {BELOW, ILL}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("budget", [20, 60])
def test_radiance_is_nowhere_negative_and_the_program_is_solved(shadow: Transfer, rule: Rule, budget: int) -> None:
    photo = observed(shadow, spotty(8, 11, items=3), noise=0.003)
    found = solve_adaptive(shadow, photo, AdaptiveHaar(8, budget, rule=rule))
    radiance = haar.synthesis(found.solution.coefficients, 8)
    assert (radiance == 0).any() or radiance.amin() < 1e-12 * radiance.amax()  # the constraint is felt
    assert (radiance.amin(dim=-1) >= -1e-9 * radiance.amax(dim=-1)).all()
    assert (found.solution.status == Status.CONVERGED).all()
    assert (found.solution.kkt_residual < 1e-9).all()
    assert (found.solution.gap < 1e-7).all()
    assert (found.refinement.functions <= budget).all()
    assert (found.refinement.functions >= 9).all()
    assert (found.solution.steps >= 1).all()
    assert not ((found.solution.coefficients != 0) & ~found.refinement.kept).any()
    assert_close(found.irradiance, radiance @ shadow.transport.T, rtol=1e-9, atol=1e-9 * float(found.irradiance.max()))
    residual = torch.linalg.vector_norm(found.irradiance - photo.samples, dim=-1)
    expected = residual / torch.linalg.vector_norm(photo.samples, dim=-1)
    assert_close(found.solution.relative_residual, expected, rtol=1e-6, atol=0)


def test_radiance_of_the_leaves_themselves_is_exactly_non_negative(
    shadow: Transfer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before Haar's transform rounds it."""
    seen: list[Tensor] = []

    def noted(texels: Tensor, resolution: int) -> Tensor:
        seen.append(texels)
        return haar.analysis(texels, resolution)

    monkeypatch.setattr("torchlight.inversion.forest.haar", type("Haar", (), {"analysis": staticmethod(noted)}))
    found = solve_adaptive(shadow, observed(shadow, spotty(8, 11, items=3), noise=0.003), AdaptiveHaar(8, 60))
    assert (seen[0] >= 0).all()
    assert (seen[0] == 0).any()
    radiance = haar.synthesis(found.solution.coefficients, 8)
    shape = seen[0].reshape(3, -1)
    assert_close(radiance / radiance.amax(), shape / shape.amax(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_what_no_sample_sees_is_never_divided_and_says_so(rule: Rule) -> None:
    generator = torch.Generator().manual_seed(3)
    tree = quadtree(8)
    matrix = torch.rand(400, 192, generator=generator, dtype=torch.float64)
    root, quarter = tree.roots[2], tree.children[40, 3]
    for node in (root, quarter):
        matrix[:, indicators(tree, node[None])[0] > 0] = 0.0
    photo = observed(Transfer(matrix, 8), spotty(8, 1))
    found = solve_adaptive(Transfer(matrix, 8), photo, AdaptiveHaar(8, 150, noise=1e-5, rule=rule))
    unseen = (matrix @ indicators(tree, tree.supports).T == 0).all(dim=0)
    assert int(unseen.sum()) == 5 + 5
    assert (found.refinement.fate[0, unseen] == UNSEEN).all()
    assert not (found.refinement.fate[0, ~unseen] == UNSEEN).any()
    assert not found.refinement.kept[0, trios(tree, unseen.nonzero()[:, 0])].any()
    assert found.refinement.functions.item() > 30
    hidden = indicators(tree, root[None])[0] > 0
    assert (haar.synthesis(found.solution.coefficients, 8)[0, hidden].abs() < 1e-12).all()


def test_squares_beyond_the_dense_transport_that_no_sample_sees_are_unseen_too() -> None:
    """A quarter of a texel of the dense transport is hidden, right beside a lamp: three columns hold no trio."""
    tree, fine = quadtree(16), block_transfer(16).transport.clone()
    dense_texel = tree.children[tree.support_of[tree.children[tree.support_of[tree.roots[8]], 1]], 2]
    quarter = tree.children[tree.support_of[dense_texel], 0]
    within = indicators(tree, torch.stack([quarter, dense_texel])) > 0
    fine[:, within[0]] = 0.0
    light = torch.full((1, 768), 0.2, dtype=torch.float64)
    light[0, within[1]] = torch.linspace(1, 900, int(within[1].sum()), dtype=torch.float64)
    transfer = Transfer(fine, 16)
    nodes = NodeColumns(coarsened(transfer, 4), 16, columns_of(transfer, []))
    found = solve_adaptive(nodes, observed(transfer, light), AdaptiveHaar(16, 120))
    fate = found.refinement.fate[0]
    assert fate[tree.support_of[dense_texel]] == ILL
    assert fate[tree.support_of[quarter]] == UNSEEN
    inside = indicators(tree, tree.supports)[:, within[0]].any(dim=1) & (tree.level[tree.supports] >= 3)
    assert (fate[inside] == UNSEEN).all()
    assert int((fate == UNSEEN).sum()) == int(inside.sum()) == 1


# --- items that fail -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [ProjectedGain(), ProjectedGain(shared=True), LevelByLevel()])
def test_every_item_ends_with_a_status_and_harms_no_other(shadow: Transfer, rule: Rule) -> None:
    photo = observed(shadow, spotty(8, 5, 3).expand(3, 3, -1).clone(), noise=0.002)
    samples, weights = photo.samples.clone(), photo.weights.clone()
    samples[0, 1, 7] = math.nan
    weights[1] = 0.0
    samples[2, 2] = 0.0
    settings = AdaptiveHaar(8, 30, rule=rule)
    found = solve_adaptive(shadow, Observation(samples, weights), settings)
    fine, nan, none = int(Status.CONVERGED), int(Status.NOT_FINITE), int(Status.NO_OBSERVATIONS)
    assert found.solution.status.tolist() == [[fine, nan, fine], [none] * 3, [fine] * 3]
    for failed in ((0, 1), (1, 0), (1, 1), (1, 2)):
        assert found.refinement.functions[failed] == found.refinement.regions[failed] == 0
        assert (found.refinement.fate[failed] == Fate.UNSOLVED).all()
        assert (found.solution.coefficients[failed] == 0).all()
        assert (found.irradiance[failed] == 0).all()
        assert found.solution.gap[failed].isnan()
    assert (found.solution.coefficients[2, 2] == 0).all()
    shared = isinstance(rule, ProjectedGain) and rule.shared
    assert (found.refinement.functions[2, 2] == 9) != shared
    samples[0, 1] = 0.0
    alone = solve_adaptive(shadow, Observation(samples[0], photo.weights[0]), settings)
    expected = alone.solution.coefficients[[0, 2]]
    assert torch.equal(found.refinement.kept[0, [0, 2]], alone.refinement.kept[[0, 2]])
    assert_close(found.solution.coefficients[0, [0, 2]], expected, rtol=1e-6, atol=1e-8 * float(expected.abs().max()))


def test_nothing_to_see_at_all(shadow: Transfer) -> None:
    found = solve_adaptive(shadow, Observation(torch.ones(2, 3, 400), torch.zeros(2, 400)), AdaptiveHaar(8, 30))
    assert (found.solution.status == Status.NO_OBSERVATIONS).all()
    assert (found.refinement.fate == Fate.UNSOLVED).all()


def test_a_support_within_an_undivided_one_shares_its_fate(shadow: Transfer) -> None:
    for rule in RULES:
        found = solve_adaptive(shadow, observed(shadow, spotty(8, 6), noise=0.002), AdaptiveHaar(8, 30, rule=rule))
        tree = quadtree(8)
        fate = found.refinement.fate[0]
        within = (tree.parent[tree.supports] >= 0).nonzero()[:, 0]
        above = tree.support_of[tree.parent[tree.supports[within]]]
        held = found.refinement.kept[0, trios(tree, torch.arange(61))].any(dim=1)
        undivided = (fate[above] != RESOLVED) & ~held[within]
        same = (fate[within] == fate[above]) | (fate[within] == UNSEEN)
        assert same[undivided & (fate[above] != LIMIT)].all()
        assert (fate == RESOLVED).any()
        assert torch.equal(fate == RESOLVED, held)


def test_output_has_the_dtype_of_the_samples(shadow: Transfer) -> None:
    photo = observed(shadow, patchy(8, 2, 3), noise=0.002)
    single = Observation(photo.samples.float(), photo.weights.float())
    found = solve_adaptive(shadow.to(dtype=torch.float32), single, AdaptiveHaar(8, 40))
    assert found.solution.coefficients.dtype == found.irradiance.dtype == torch.float32
    exact = solve_adaptive(shadow, photo, AdaptiveHaar(8, 40)).solution.coefficients
    assert exact.dtype == torch.float64
    assert_close(found.solution.coefficients.double(), exact, rtol=1e-3, atol=1e-3 * float(exact.max()))


# --- settings ------------------------------------------------------------------------------------------------------


def test_what_is_used_where_nothing_is_said() -> None:
    settings = AdaptiveHaar()
    assert (settings.max_resolution, settings.budget, settings.dense_resolution) == (128, 450, 16)
    assert settings.rule == named_rule("gain") == ProjectedGain(threshold=8.0, share=0.05, spare=18, shared=False)
    assert named_rule("paper") == LevelByLevel()
    assert settings.noise is None  # as measured
    assert settings.basis.resolution == 128
    assert AdaptiveHaar(8).dense_resolution == 8


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: AdaptiveHaar(12), "max_resolution"),
        (lambda: AdaptiveHaar(1), "max_resolution"),
        (lambda: AdaptiveHaar(1024), "from 2 to 512, got 1024"),
        (lambda: AdaptiveHaar(budget=8), "at least 9"),
        (lambda: AdaptiveHaar(noise=0.0), "noise"),
        (lambda: AdaptiveHaar(condition_limit=0.0), "condition_limit"),
        (lambda: ProjectedGain(threshold=-1.0), "threshold"),
        (lambda: ProjectedGain(threshold=math.nan), "threshold"),
        (lambda: ProjectedGain(share=0.0), "share"),
        (lambda: ProjectedGain(share=1.5), "share"),
        (lambda: ProjectedGain(spare=-1), "spare"),
        (lambda: LevelByLevel(1.0), "threshold"),
        (lambda: named_rule("oracle"), "gain or paper"),
    ],
)
def test_settings_out_of_range_are_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make()


def test_the_transport_must_have_the_resolution_of_the_settings(shadow: Transfer) -> None:
    for resolution in (4, 16):
        with pytest.raises(ShapeError, match=f"max_resolution is {resolution}, the transport's 8"):
            solve_adaptive(shadow, observed(shadow, spotty(8, 1)), AdaptiveHaar(resolution))
