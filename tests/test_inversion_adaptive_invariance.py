"""What the adaptive method does not depend on, whatever the rule: scale, weights, neighbours, order, threads."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from shadows import block_transfer, observed, patchy, spotty
from torch.testing import assert_close

from torchlight.inversion import adaptive
from torchlight.inversion.adaptive import AdaptiveHaar, Rule, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.photo.observation import Observation
from torchlight.transfer import Transfer

RULES = [ProjectedGain(), ProjectedGain(1.0, share=0.5), ProjectedGain(shared=True), LevelByLevel(), LevelByLevel(1e-3)]


@pytest.fixture(scope="module")
def shadow() -> Transfer:
    """A block on 20 x 20 samples, 8 x 8 texels per face."""
    return block_transfer(8)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("factor", [4.0, 1e-6, 3.7])
def test_a_brighter_photograph_gives_a_brighter_light(shadow: Transfer, rule: Rule, factor: float) -> None:
    photo = observed(shadow, patchy(8, 2), noise=0.002)
    settings = AdaptiveHaar(8, 40, rule=rule)
    plain = solve_adaptive(shadow, photo, settings)
    scaled = solve_adaptive(shadow, replace(photo, samples=factor * photo.samples), settings)
    assert torch.equal(plain.refinement.kept, scaled.refinement.kept)
    assert torch.equal(plain.refinement.fate, scaled.refinement.fate)
    expected = factor * plain.solution.coefficients
    assert_close(scaled.solution.coefficients, expected, rtol=1e-6, atol=1e-8 * float(expected.abs().max()))


@pytest.mark.parametrize("rule", RULES)
def test_weight_0_is_absence(shadow: Transfer, rule: Rule) -> None:
    photo = observed(shadow, patchy(8, 4), noise=0.002)
    settings = AdaptiveHaar(8, 40, rule=rule)
    gone = torch.zeros(400, dtype=torch.bool)
    gone[::3] = True
    samples = photo.samples.clone()
    samples[:, gone] = math.nan
    masked = solve_adaptive(shadow, Observation(samples, photo.weights.masked_fill(gone, 0.0)), settings)
    rows = Transfer(shadow.transport[~gone], 8)
    removed = solve_adaptive(rows, Observation(photo.samples[:, ~gone], photo.weights[~gone]), settings)
    assert torch.equal(masked.refinement.kept, removed.refinement.kept)
    expected = removed.solution.coefficients
    assert_close(masked.solution.coefficients, expected, rtol=1e-6, atol=1e-8 * float(expected.abs().max()))


@pytest.mark.parametrize("rule", RULES)
def test_weight_2_is_a_sample_seen_twice(shadow: Transfer, rule: Rule) -> None:
    photo = observed(shadow, patchy(8, 6), noise=0.002)
    settings = AdaptiveHaar(8, 40, rule=rule)
    twice = torch.arange(400) % 4 == 0
    index = torch.cat([torch.arange(400), torch.arange(400)[twice]])
    repeated = solve_adaptive(
        Transfer(shadow.transport[index], 8), Observation(photo.samples[:, index], photo.weights[index]), settings
    )
    weighted = solve_adaptive(shadow, Observation(photo.samples, photo.weights + twice), settings)
    assert torch.equal(weighted.refinement.kept, repeated.refinement.kept)
    expected = repeated.solution.coefficients
    assert_close(weighted.solution.coefficients, expected, rtol=1e-6, atol=1e-8 * float(expected.abs().max()))
    assert_close(weighted.solution.gap, repeated.solution.gap, rtol=0, atol=1e-9)


def photographs(shadow: Transfer) -> Observation:
    """Five photographs in three groups of equal weights, one by one and not side by side."""
    kinds, size = (spotty, patchy, spotty, patchy, spotty), shadow.resolution
    light = torch.stack([kind(size, seed, 3) for seed, kind in enumerate(kinds)])
    photo = observed(shadow, light, noise=0.002)
    weights = photo.weights.clone()
    weights[1, ::5] = 0.0
    weights[3, ::5] = 0.0
    weights[4] *= 2.0
    return Observation(photo.samples, weights)


@pytest.mark.parametrize(
    ("rule", "resolution", "most"),
    [
        (ProjectedGain(), 8, 2**25),
        (ProjectedGain(), 8, 1),
        (ProjectedGain(shared=True), 8, 2**25),
        (LevelByLevel(1e-3), 4, 2**25),
    ],
)
def test_a_batch_gives_what_each_photograph_gives_alone(
    rule: Rule, resolution: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever their number, their order, their neighbours' weights and how many are worked on together."""
    monkeypatch.setattr(adaptive, "ENTRIES_PER_BLOCK", most)
    shadow = block_transfer(resolution)
    photos, settings = photographs(shadow), AdaptiveHaar(resolution, 45, rule=rule)
    order = [3, 0, 4, 2, 1]
    batch = solve_adaptive(shadow, Observation(photos.samples[:, None], photos.weights[:, None]), settings)
    mixed = solve_adaptive(shadow, Observation(photos.samples[order], photos.weights[order]), settings)
    assert batch.refinement.kept.shape == (5, 1, 3, 3 * resolution**2)
    for k in range(5):
        alone = solve_adaptive(shadow, Observation(photos.samples[k], photos.weights[k]), settings)
        largest = alone.solution.coefficients.abs().amax(dim=-1, keepdim=True)
        for found in (batch.solution.coefficients[k, 0], mixed.solution.coefficients[order.index(k)]):
            assert ((found - alone.solution.coefficients).abs() <= 1e-6 * largest).all()
        for name in ("kept", "fate", "regions"):
            assert torch.equal(getattr(batch.refinement, name)[k, 0], getattr(alone.refinement, name))
            assert torch.equal(getattr(mixed.refinement, name)[order.index(k)], getattr(alone.refinement, name))
        assert_close(batch.irradiance[k, 0], alone.irradiance, rtol=1e-8, atol=0)


def test_each_photograph_has_the_noise_measured_in_it() -> None:
    """In a batch as alone, and as if it were stated; a stated noise goes before a measured one."""
    shadow, shares = block_transfer(8), torch.tensor([0.002, 0.05, 0.01, 0.002, 0.03])
    photos = photographs(shadow)
    batch = solve_adaptive(shadow, photos, AdaptiveHaar(8, 45), shares)
    assert_close(batch.noise, shares.to(photos.samples))
    stated = solve_adaptive(shadow, photos, AdaptiveHaar(8, 45, noise=0.01), shares)
    assert_close(stated.noise, torch.full((5,), 0.01, dtype=photos.samples.dtype))
    for k in range(5):
        alone = Observation(photos.samples[k], photos.weights[k])
        told = solve_adaptive(shadow, alone, AdaptiveHaar(8, 45, noise=shares[k].item()))
        assert torch.equal(batch.refinement.kept[k], told.refinement.kept)
        assert torch.equal(batch.refinement.fate[k], told.refinement.fate)
        assert_close(batch.irradiance[k], told.irradiance, rtol=1e-8, atol=0)
    assert batch.refinement.functions[0].sum() > batch.refinement.functions[1].sum()
    plain = solve_adaptive(shadow, photos, AdaptiveHaar(8, 45))
    assert_close(plain.noise, torch.full((5,), 0.4 / 255, dtype=photos.samples.dtype))


@pytest.mark.parametrize(
    ("rule", "resolution"), [(ProjectedGain(), 8), (ProjectedGain(shared=True), 8), (LevelByLevel(1e-3), 4)]
)
def test_one_and_two_threads_give_the_same_bits(rule: Rule, resolution: int) -> None:
    shadow = block_transfer(resolution)
    photos = photographs(shadow)
    before = torch.get_num_threads()
    answers = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            answers.append(solve_adaptive(shadow, photos, AdaptiveHaar(resolution, 45, rule=rule)))
            assert torch.get_num_threads() == count
    finally:
        torch.set_num_threads(before)
    one, two = answers
    for name in ("coefficients", "relative_residual", "kkt_residual", "gap", "steps", "status"):
        assert torch.equal(getattr(one.solution, name), getattr(two.solution, name)), name
    for name in ("kept", "fate", "regions"):
        assert torch.equal(getattr(one.refinement, name), getattr(two.refinement, name)), name
    assert torch.equal(one.irradiance, two.irradiance)
