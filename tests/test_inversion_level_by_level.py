"""The paper's rule: what it keeps, what it freezes, and the program of dropped wavelets it solves."""

from __future__ import annotations

import pytest
import torch
from shadows import block_transfer, columns_of, observed, seeing_each_texel, spotty

from torchlight.errors import ConfigError
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.quadtree import indicators, quadtree
from torchlight.inversion.refinement import Fate
from torchlight.light import haar
from torchlight.transfer import Transfer

RESOLVED, BELOW, ILL, UNSEEN, LIMIT = (int(fate) for fate in list(Fate)[:5])


def test_what_is_large_stays_and_what_is_small_is_frozen() -> None:
    """One sample per texel, so that coefficients are those of the light; squares as shares of their sum are known."""
    tree = quadtree(4)
    coefficients = torch.zeros(1, 48, dtype=torch.float64)
    coefficients[:, tree.root_coefficients] = 4.0  # 9 x 16 = 144
    top = int(tree.trios[8])
    coefficients[0, top : top + 3] = torch.tensor([2.0, 1.0, 0.25], dtype=torch.float64)
    first_quarter, last_quarter = int(tree.trios[9]), int(tree.trios[12])
    coefficients[0, first_quarter + 1] = 1.5
    coefficients[0, last_quarter] = 0.25
    transfer = seeing_each_texel(4)
    photo = observed(transfer, haar.synthesis(coefficients, 4))
    found = solve_adaptive(transfer, photo, AdaptiveHaar(4, rule=LevelByLevel(1e-3)))
    wanted = torch.where(coefficients.abs() < 0.5, 0.0, coefficients)  # 0.25^2 / 151 < 1e-3
    torch.testing.assert_close(found.solution.coefficients, wanted, rtol=1e-8, atol=1e-8)
    assert found.refinement.functions.item() == 9 + 3
    assert tree.supports[found.refinement.fate[0] == RESOLVED].tolist() == [40, 41]
    assert found.refinement.regions.item() == 9 + 3 + 3


def test_the_rule_never_looks_below_a_support_whose_wavelets_left_and_growth_does_not_either() -> None:
    """A chequered top face has no coarse wavelets: the light stays a constant."""
    light = torch.ones(1, 48, dtype=torch.float64)
    light[0, 32:] += torch.tensor([[1.0, -1.0], [-1.0, 1.0]], dtype=torch.float64).repeat(2, 2).reshape(-1) * 0.9
    transfer = seeing_each_texel(4)
    for rule in (LevelByLevel(), ProjectedGain()):
        found = solve_adaptive(transfer, observed(transfer, light), AdaptiveHaar(4, rule=rule))
        assert found.refinement.functions.item() == 9
        assert (found.refinement.fate[0, 8:] == BELOW).all()


@pytest.mark.parametrize("rule", [LevelByLevel(), ProjectedGain()])
@pytest.mark.parametrize("alike", [(0, 1, 2, 3), (0, 2)])
def test_a_trio_that_cannot_be_told_apart_does_not_join_whatever_it_explains(
    rule: ProjectedGain | LevelByLevel, alike: tuple[int, ...]
) -> None:
    """Of the first quarter of the top face no sample tells all four texels apart, or the two on its left."""
    tree, plain = quadtree(4), seeing_each_texel(4)
    texels = indicators(tree, tree.children[9]).argmax(dim=1)
    matrix = plain.transport.clone()
    same = texels[list(alike)]
    matrix[:, same] = matrix[:, same].mean(dim=1, keepdim=True)
    light = torch.ones(1, 48, dtype=torch.float64)
    light[0, texels[1]] = 30.0
    found = solve_adaptive(Transfer(matrix, 4), observed(Transfer(matrix, 4), light), AdaptiveHaar(4, rule=rule))
    assert found.refinement.fate[0, 8] == RESOLVED
    assert found.refinement.fate[0, 9] == ILL
    assert not found.refinement.kept[0, tree.trios[9] : tree.trios[9] + 3].any()
    told_apart = solve_adaptive(plain, observed(plain, light), AdaptiveHaar(4, rule=rule))
    assert told_apart.refinement.fate[0, 9] == RESOLVED


def test_the_budget_is_kept_by_squared_coefficients() -> None:
    shadow = block_transfer(8)
    photo = observed(shadow, spotty(8, 3))
    free = solve_adaptive(shadow, photo, AdaptiveHaar(8, 192, rule=LevelByLevel(1e-6)))
    bound = solve_adaptive(shadow, photo, AdaptiveHaar(8, 30, rule=LevelByLevel(1e-6)))
    assert free.refinement.functions.item() > 30
    assert bound.refinement.functions.item() <= 30
    assert LIMIT in bound.refinement.fate.unique().tolist()


def test_single_wavelets_are_dropped() -> None:
    shadow, tree = block_transfer(8), quadtree(8)
    found = solve_adaptive(shadow, observed(shadow, spotty(8, 3)), AdaptiveHaar(8, 192, rule=LevelByLevel(1e-3)))
    per_support = torch.stack([found.refinement.kept[0, tree.trios + k] for k in range(3)]).sum(dim=0)
    assert ((per_support == 1) | (per_support == 2)).any()
    assert torch.equal(per_support > 0, found.refinement.fate[0] == RESOLVED)
    assert found.refinement.regions.item() > found.refinement.functions.item()


def test_the_rule_works_on_dense_transports_only() -> None:
    fine = block_transfer(8)
    coarse = Transfer(torch.rand(400, 48, dtype=torch.float64), 4)
    deeper = NodeColumns(coarse, 8, columns_of(fine, []))
    with pytest.raises(ConfigError, match="the paper's rule takes max_resolution at most 16"):
        solve_adaptive(deeper, observed(fine, spotty(8, 1)), AdaptiveHaar(8, rule=LevelByLevel()))
