"""Growth by projected gain: its formula, exhaustive search over trees, budgets, and why it stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from shadows import (
    BLOCK,
    RECEIVER,
    block_transfer,
    coarsened,
    items_of,
    observed,
    patchy,
    seeing_each_texel,
    spotty,
    whole,
)
from torch import Tensor
from torch.testing import assert_close

from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.forest import Forest, Items, seedlings
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.growth import Pace, divide, fit, joining, projected_gain, whole_quads
from torchlight.inversion.quadtree import Quadtree, indicators, quadtree
from torchlight.inversion.refinement import Fate, constants
from torchlight.light import haar
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.photo.observation import Observation
from torchlight.synthetic import block_values, pixel_rays
from torchlight.transfer import Transfer

RESOLVED, BELOW, ILL, UNSEEN, LIMIT = (int(fate) for fate in list(Fate)[:5])
ONE_BY_ONE = ProjectedGain(threshold=0.0, share=1e-9)
THREE = AdaptiveHaar(8, 9 + 9, noise=0.002, rule=ProjectedGain(threshold=0.0), condition_limit=1e6)


# --- against exhaustive search -------------------------------------------------------------------------------------


def trees(tree: Quadtree, divisions: int) -> list[Tensor]:
    """Returns every tree of so many divisions, grown one division at a time in all possible ways."""
    grown = {frozenset[int]()}
    for _ in range(divisions):
        grown = {
            chosen | {int(support)}
            for chosen in grown
            for support in tree.support_of[tree.leaves(as_mask(tree, chosen))].tolist()
            if support >= 0
        }
    return [as_mask(tree, chosen) for chosen in grown]


def as_mask(tree: Quadtree, chosen: frozenset[int]) -> Tensor:
    index = torch.tensor(sorted(chosen), dtype=torch.long)
    return torch.zeros_like(tree.supports, dtype=torch.bool).index_fill(0, index, True)


def leaf_columns(transfer: Transfer, divisions: int) -> list[np.ndarray]:
    tree = quadtree(transfer.resolution)
    return [(transfer.transport @ indicators(tree, tree.leaves(one)).T).numpy() for one in trees(tree, divisions)]


def objective_ratio(transfer: Transfer, photo: Observation, columns: list[np.ndarray], settings: AdaptiveHaar) -> float:
    """Returns the squared residual of the growth over that of the best of all trees."""
    found = solve_adaptive(transfer, photo, settings)
    assert found.refinement.functions.item() <= settings.budget
    target = photo.samples[0].numpy()
    least = min(nnls(some, target)[1] for some in columns) / np.linalg.norm(target)
    return float((found.solution.relative_residual.item() / least) ** 2)


def real_photo(light: EnvironmentMap) -> Observation:
    """What the block's receiver shows by its analytic shadow, one channel, 8 bits: no square of the tree made it."""
    values = block_values(BLOCK, RECEIVER, pixel_rays(light))[1:2]
    return Observation((values / values.max() * 250).round() / 250, torch.ones(RECEIVER.points, dtype=torch.float64))


@pytest.mark.parametrize(("resolution", "count", "lights"), [(4, 122, 20), (8, 442, 8)])
@pytest.mark.parametrize("kind", [spotty, patchy])
def test_growth_is_near_the_best_of_all_trees_of_three_divisions(
    kind: Callable[[int, int], Tensor], resolution: int, count: int, lights: int
) -> None:
    transfer, settings = coarsened(block_transfer(8), resolution), replace(THREE, max_resolution=resolution)
    columns = leaf_columns(transfer, 3)
    assert len(columns) == count
    ratios = [
        objective_ratio(transfer, observed(transfer, kind(resolution, seed), 0.002, seed), columns, settings)
        for seed in range(lights)
    ]
    assert np.median(ratios) <= 1.05
    assert max(ratios) <= 1.8
    assert min(ratios) > 1 - 1e-6


def test_growth_finds_the_best_of_all_trees_for_a_sun_and_a_window() -> None:
    """Three levels deep, and light that no tree holds: by the analytic shadow of the block, 8 bits."""
    transfer = block_transfer(8, 64)
    columns = leaf_columns(transfer, 3)
    assert len(columns) == 442
    ratio = objective_ratio(transfer, real_photo(sun_and_window(64)), columns, THREE)
    assert abs(ratio - 1) < 1e-6


@pytest.mark.parametrize("kind", [spotty, patchy])
def test_growth_finds_the_best_trio_first(kind: Callable[[int, int], Tensor]) -> None:
    transfer = coarsened(block_transfer(8), 4)
    columns = leaf_columns(transfer, 1)
    assert len(columns) == 9
    settings = AdaptiveHaar(4, 12, noise=0.002, rule=ONE_BY_ONE, condition_limit=1e6)
    ratios = [
        objective_ratio(transfer, observed(transfer, kind(4, seed), 0.002, seed), columns, settings)
        for seed in range(20)
    ]
    assert np.median(ratios) < 1 + 1e-6
    assert max(ratios) < 1.8
    assert min(ratios) > 1 - 1e-6


# --- the formula ---------------------------------------------------------------------------------------------------


def test_gain_is_what_the_formula_says_on_the_samples_themselves() -> None:
    transfer, tree = block_transfer(8), quadtree(8)
    items = items_of(whole(transfer), observed(transfer, patchy(8, 5), noise=0.01), noise=0.01)
    matrix, target, sigma = transfer.transport, items.targets[0, 0], float(items.sigmas[0])
    forest = seedlings(items, 30)
    fit(items, forest, 0)
    first = torch.tensor([0, 8])  # places of leaves: a side's root and the top face
    yes = torch.ones(2, dtype=torch.bool)
    assert divide(items, forest, 0, first, torch.tensor([5.0, 7.0]).double(), yes, Pace(1.0, 1.0, 30))
    fit(items, forest, 0)
    count = int(forest.counts[0])
    assert count == 15
    leaves, values = forest.leaves[0, :count], forest.values[0, 0, :count]
    candidates = (tree.support_of[leaves] >= 0).nonzero()[:, 0]
    gain, sound = projected_gain(items, forest, 0, candidates, 10.0)
    shapes = indicators(tree, leaves)
    used = (matrix @ shapes[values > 0].T).numpy()
    residual = (target - matrix @ shapes.T @ values).numpy()
    mean = float((shapes.T @ values).mean())
    synthesis = haar.synthesis(torch.eye(192, dtype=torch.float64), 8)
    seen = []
    for place, leaf in enumerate(candidates.tolist()):
        start = tree.trios[tree.support_of[leaves[leaf]]]
        psi = synthesis[start : start + 3]
        w = (matrix @ (psi / psi.abs().max()).T).numpy()
        new = w - used @ np.linalg.lstsq(used, w, rcond=None)[0]
        here = float(values[leaf])
        g = w.T @ residual
        y = np.linalg.solve(new.T @ new + (sigma / max(here, 0.3 * mean)) ** 2 * np.eye(3), g)
        s = min(1.0, 2 * max(here, 0.05 * mean) / np.abs(y).max())
        smallest = np.linalg.eigvalsh(new.T @ new)[0]
        seen.append(smallest * (10 * (mean + here)) ** 2 >= sigma**2)
        expected = (2 * s - s * s) * float(g @ y) / sigma**2 if seen[-1] else 0.0
        assert_close(gain[place].item(), expected, rtol=1e-6, atol=1e-6)
    assert sound.tolist() == seen


def test_one_bright_texel_divides_its_ancestors_and_nothing_else() -> None:
    light = torch.ones(1, 48, dtype=torch.float64)
    light[0, 32 + 6] = 9.0  # top face, row 1, column 2
    transfer = seeing_each_texel(4)
    found = solve_adaptive(transfer, observed(transfer, light), AdaptiveHaar(4))
    tree = quadtree(4)
    assert_close(found.solution.coefficients, haar.analysis(light, 4), rtol=1e-9, atol=1e-9)
    resolved = tree.supports[found.refinement.fate[0] == RESOLVED]
    assert resolved.tolist() == [40, 42]  # the face and its upper right quarter
    assert found.refinement.functions.item() == 9 + 6
    assert found.refinement.regions.item() == 9 + 6
    assert found.refinement.fate[0].unique().tolist() == [RESOLVED, BELOW]


# --- budgets and other ends ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [ProjectedGain(), ProjectedGain(share=1.0), ProjectedGain(shared=True)])
def test_never_more_functions_than_asked_for_and_limit_where_that_ended_it(rule: ProjectedGain) -> None:
    transfer = block_transfer(8)
    photo = observed(transfer, spotty(8, 3, 3), noise=0.001)
    for budget in (9, 10, 11, 12, 20, 59):
        found = solve_adaptive(transfer, photo, AdaptiveHaar(8, budget, noise=0.001, rule=rule)).refinement
        full = 9 + 3 * ((budget - 9) // 3)
        assert found.functions.tolist() == [full] * 3
        assert found.regions.tolist() == [full] * 3
        assert (found.fate == LIMIT).any(dim=-1).all()
    free = solve_adaptive(transfer, photo, AdaptiveHaar(8, 192, noise=0.05, rule=rule)).refinement
    assert (free.functions < 192).all()
    assert not (free.fate == LIMIT).any()


def test_a_budget_of_9_is_the_best_constants() -> None:
    transfer, tree = block_transfer(8), quadtree(8)
    photo = observed(transfer, spotty(8, 3), noise=0.001)
    found = solve_adaptive(transfer, photo, AdaptiveHaar(8, 9, noise=0.001))
    assert torch.equal(found.refinement.kept[0], constants(tree))
    expected = nnls((transfer.transport @ indicators(tree, tree.roots).T).numpy(), photo.samples[0].numpy())[0]
    heights = torch.cat([torch.full((8,), 2.0), torch.ones(1)]).double()
    values = found.solution.coefficients[0, tree.root_coefficients] * heights
    assert_close(values, torch.from_numpy(expected), rtol=1e-7, atol=1e-8 * expected.max())


def test_more_functions_never_explain_less() -> None:
    transfer = block_transfer(8)
    photo = observed(transfer, spotty(8, 7), noise=0.001)
    residuals = [
        solve_adaptive(transfer, photo, AdaptiveHaar(8, budget, 0.001, ONE_BY_ONE)).solution.relative_residual.item()
        for budget in (9, 15, 30, 60)
    ]
    assert residuals == sorted(residuals, reverse=True)
    assert residuals[-1] < 0.5 * residuals[0]


def test_nothing_is_determined_where_no_change_of_light_may_show() -> None:
    transfer = block_transfer(8)
    photo = observed(transfer, spotty(8, 7), noise=0.001)
    found = solve_adaptive(transfer, photo, AdaptiveHaar(8, 60, condition_limit=1e-9)).refinement
    assert found.functions.item() == 9
    assert (found.fate == ILL).all()


def test_a_higher_threshold_stops_earlier_and_says_below_threshold() -> None:
    transfer = block_transfer(8)
    photo = observed(transfer, spotty(8, 9), noise=0.002)
    counts = []
    for threshold in (0.0, 8.0, 1e3, 1e9):
        found = solve_adaptive(transfer, photo, AdaptiveHaar(8, 192, 0.002, ProjectedGain(threshold))).refinement
        counts.append(found.functions.item())
        assert not (found.fate == LIMIT).any()
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2] > counts[3] == 9
    assert (found.fate == BELOW).any()


def test_channels_that_share_their_functions_have_one_tree_and_their_own_light() -> None:
    transfer = block_transfer(8)
    photo = observed(transfer, torch.stack([patchy(8, 1, 3), patchy(8, 2, 3)]), noise=0.002)
    apart = solve_adaptive(transfer, photo, AdaptiveHaar(8, 60))
    together = solve_adaptive(transfer, photo, AdaptiveHaar(8, 60, rule=ProjectedGain(shared=True)))
    assert not torch.equal(apart.refinement.kept[0, 0], apart.refinement.kept[0, 1])
    for k in range(2):
        for name in ("kept", "fate", "regions"):
            values = getattr(together.refinement, name)[k]
            assert torch.equal(values, values[:1].expand_as(values))
    assert not torch.equal(together.refinement.kept[0, 0], together.refinement.kept[1, 0])
    one = Observation(photo.samples[0, :1], photo.weights[0])
    alone = solve_adaptive(transfer, one, AdaptiveHaar(8, 60, rule=ProjectedGain(shared=True)))
    expected = solve_adaptive(transfer, one, AdaptiveHaar(8, 60))
    assert torch.equal(alone.solution.coefficients, expected.solution.coefficients)


# --- pruning -------------------------------------------------------------------------------------------------------


def test_joining_costs_what_the_samples_say() -> None:
    """Against the squared residual itself, with the four radiances replaced by their best common one >= 0."""
    transfer = block_transfer(8)
    items = items_of(whole(transfer), observed(transfer, spotty(8, 11), noise=0.01), noise=0.01)
    forest = seedlings(items, 21)
    divide_all(items, forest, [0, 8, 3, 8])
    fit(items, forest, 0)
    leaves = forest.leaves[0, : int(forest.counts[0])]
    columns, target, values = items.weighted.columns[leaves], items.targets[0, 0], forest.values[0, 0, : len(leaves)]
    places = whole_quads(items, leaves)
    assert places.shape == (3, 4)  # the top face's own quarters are not all leaves
    losses, joined = joining(items, forest, 0, places)
    before = (target - values @ columns).square().sum()
    for k, four in enumerate(places):
        rest = values.clone()
        rest[four] = 0.0
        together, wanted = columns[four].sum(dim=0), target - rest @ columns
        best = ((wanted @ together) / (together @ together)).clamp(min=0)
        assert_close(joined[0, k], best, rtol=1e-9, atol=1e-12)
        after = (wanted - best * together).square().sum()
        assert_close(losses[k], after - before, rtol=1e-7, atol=1e-9 * float(before))


def divide_all(items: Items, forest: Forest, places: list[int]) -> None:
    """Divides leaves one after another, whatever they gain."""
    for place in places:
        gain, yes = torch.ones(1, dtype=torch.float64), torch.ones(1, dtype=torch.bool)
        assert divide(items, forest, 0, torch.tensor([place]), gain, yes, Pace(0.0, 1.0, 21))


def test_pruning_takes_back_what_explains_nothing() -> None:
    """One sample per texel: the squares of three wavelets say which division to undo."""
    transfer = seeing_each_texel(4)
    tree = quadtree(4)
    light = torch.ones(1, 48, dtype=torch.float64)
    for place, step in ((0, 0.3), (3, 0.01), (6, 0.2)):
        light[0] += step * indicators(tree, tree.children[tree.support_of[tree.roots[place]], :1])[0]
    photo = observed(transfer, light)
    rule = ProjectedGain(threshold=0.0, share=1e-9)
    found = solve_adaptive(transfer, photo, AdaptiveHaar(4, 15, rule=rule)).refinement
    resolved = tree.supports[(found.fate[0] == RESOLVED)]
    assert resolved.tolist() == [int(tree.roots[0]), int(tree.roots[6])]
    assert found.fate[0, tree.support_of[tree.roots[3]]] == LIMIT
