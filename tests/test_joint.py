"""Several photographs solved together: closed forms, scipy on the stacked equations, and what must not matter."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor
from torch.testing import assert_close

from torchlight import metrics
from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.scales import bright
from torchlight.joint import (
    JointEstimate,
    View,
    estimate_together,
    explain_together,
    explain_together_robustly,
    side_by_side,
    with_confidence,
)
from torchlight.light import latlong
from torchlight.light.bases import Texels
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.noise import brightest_used, noise_share
from torchlight.photo.observation import Observation, Rejection, linear_photo
from torchlight.pipeline import explain
from torchlight.pipeline import with_confidence as single_confidence
from torchlight.relighting import irradiance
from torchlight.solvers import NNLS
from torchlight.synthetic import block_scene, block_values, pixel_rays, receiver_image
from torchlight.transfer import Transfer, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (20, 20))
BLOCKS = (
    Block((1.0, 0.6, 1.2), 20.0),
    Block((1.0, 0.6, 1.2), 69.0, (0.3, 0.2)),
    Block((1.0, 0.6, 1.2), -25.0, (-0.4, 0.3)),
)
RESOLUTION = 8
BASIS = Texels(RESOLUTION)
EXPOSURES = (1.0, 0.6)


def scene(index: int) -> Scene:
    return block_scene(BLOCKS[index], RECEIVER)


@cache
def transfer(index: int) -> Transfer:
    return transport(scene(index), RESOLUTION, 4).to(dtype=torch.float64)


def lamps(height: int = 64) -> EnvironmentMap:
    """Three soft lamps, 0.1 + sum of colour exp(20 (cos - 1)): 8 x 8 texels hold them, noise alone is left."""
    azimuths = torch.tensor([40.0, 150.0, 265.0], dtype=torch.float64).deg2rad()
    heights = torch.tensor([50.0, 30.0, 50.0], dtype=torch.float64).deg2rad()
    level = heights.cos()
    axes = torch.stack([level * azimuths.cos(), level * azimuths.sin(), heights.sin()])  # [3 lamps]
    colours = torch.tensor([[3.0, 1.0, 2.0], [2.0, 2.0, 3.0], [1.0, 3.0, 2.0]], dtype=torch.float64)  # [RGB lamps]
    strength = (20 * (latlong.pixel_directions(height).double() @ axes - 1)).exp()
    return EnvironmentMap(0.1 + (strength @ colours.T).permute(2, 0, 1))


@cache
def truth(index: int) -> Tensor:
    """v = E / pi of a pose under the lamps, by the analytic shadow."""
    return block_values(BLOCKS[index], RECEIVER, pixel_rays(lamps()))


def used(index: int) -> Tensor:
    return (transfer(index).transport.sum(dim=1) > 0).double()


def photographed(index: int, exposure: float, noise: float = 0.01) -> Observation:
    values = truth(index) * exposure
    drawn = torch.randn(values.shape, generator=torch.Generator().manual_seed(index), dtype=values.dtype)
    return Observation(values + noise * values.max() * drawn, used(index))


def views(scales: tuple[float | None, ...] = (None, None), noise: float = 0.01) -> list[View]:
    parts = enumerate(zip(EXPOSURES, scales, strict=True))
    return [View(scene(k), photographed(k, exposure, noise), scale) for k, (exposure, scale) in parts]


def joint(photographs: list[View], solver: NNLS | AdaptiveHaar | None = None) -> JointEstimate:
    chosen = NNLS() if solver is None else solver
    scenes, transfers = [view.scene for view in photographs], [transfer(0), transfer(1)]
    basis = chosen.basis if isinstance(chosen, AdaptiveHaar) else BASIS
    return explain_together(photographs, side_by_side(scenes, transfers, chosen), basis, chosen)


def on_third(coefficients: Tensor, exposure: float = 1.0) -> float:
    shown = irradiance(transfer(2).transport.double(), coefficients) / (math.pi * exposure)
    return metrics.rms_255(shown, truth(2), used(2)).item()


def test_the_light_is_scipys_of_the_stacked_equations() -> None:
    """Exposures given and noise equal: the rows of both photographs, each over its exposure and its noise."""
    found = joint(views(EXPOSURES))
    noise = found.scales.noise
    weights = [used(k) * (noise.min() / noise[k]) ** 2 for k in (0, 1)]
    matrix = torch.cat([transfer(k).transport.double() * weights[k].sqrt()[:, None] for k in (0, 1)])
    samples = [photographed(k, EXPOSURES[k]).samples * math.pi / EXPOSURES[k] * weights[k].sqrt() for k in (0, 1)]
    for channel, target in enumerate(torch.cat(samples, dim=-1)):
        expected, residual = nnls(matrix.numpy(), target.numpy())
        own = (matrix @ found.estimate.solution.coefficients[channel] - target).norm().item()
        assert_close(own, float(residual), rtol=1e-9, atol=0)
        assert_close(matrix @ found.estimate.solution.coefficients[channel], matrix @ torch.from_numpy(expected))


def test_a_second_pose_of_unknown_exposure_helps_on_a_third() -> None:
    alone = [explain(view.observation, view.scene, transfer(k), BASIS, NNLS()) for k, view in enumerate(views())]
    found = joint(views())
    assert_close(found.scales.values[1].item(), 0.6, rtol=4 * found.scales.deviations[1].item(), atol=0)
    together = on_third(found.estimate.solution.coefficients)
    assert together < 0.9 * on_third(alone[0].solution.coefficients)
    assert together < 0.9 * on_third(alone[1].solution.coefficients, 0.6)


def test_each_photograph_is_predicted_at_its_own_exposure() -> None:
    found = joint(views())
    for k, shown in enumerate(found.predicted):
        assert_close(
            shown,
            irradiance(transfer(k).transport.double(), found.estimate.solution.coefficients)
            * found.scales.values[k]
            / math.pi,
        )
        expected = metrics.rms_255(shown, photographed(k, EXPOSURES[k]).samples, used(k))
        assert_close(found.rms_255[k], expected)
    assert found.rms_255.max() < 4
    assert found.estimate.observation.samples.shape == (3, 2 * RECEIVER.points)
    assert_close(found.estimate.predicted[:, : RECEIVER.points], found.predicted[0])


def colour(albedo: tuple[float, float, float]) -> Tensor:
    """In float64, as the samples are: an albedo rounded to float32 is another one, and the light shows it."""
    return torch.tensor(albedo, dtype=torch.float64)[:, None]


def test_known_albedos_do_not_change_the_light() -> None:
    plain = joint(views())
    albedos = ((0.8, 0.6, 0.4), (0.5, 0.7, 0.9))
    painted = [
        View(
            replace(view.scene, receiver=replace(RECEIVER, albedo=albedo)),
            replace(view.observation, samples=view.observation.samples * colour(albedo)),
        )
        for view, albedo in zip(views(), albedos, strict=True)
    ]
    found = joint(painted)
    assert_close(found.scales.values, plain.scales.values)
    assert_close(found.estimate.solution.coefficients, plain.estimate.solution.coefficients, rtol=1e-5, atol=1e-6)
    assert_close(found.predicted[1], plain.predicted[1] * colour(albedos[1]), rtol=1e-5, atol=1e-6)


def test_a_noisier_photograph_counts_less() -> None:
    noisy = [views()[0], View(scene(1), photographed(1, 0.6, 0.05))]
    found = joint(noisy)
    weights = found.estimate.observation.weights.split(RECEIVER.points)
    assert_close(weights[0], used(0))
    assert weights[1].max().item() == pytest.approx((found.scales.noise[0] / found.scales.noise[1]).item() ** 2)
    shares = [n * truth(k).max() / bright(Observation(truth(k), used(k))) for k, n in enumerate((0.01, 0.05))]
    assert_close(found.scales.noise, torch.stack(shares), rtol=0.1, atol=0)


def test_the_adaptive_method_weighs_photographs_by_the_noise_measured_in_each() -> None:
    """At one exposure: the second, of 0.6 times the exposure, has the deviation n_2 / 0.6."""
    noisy = [views()[0], View(scene(1), photographed(1, 0.6, 0.05))]
    found = joint(noisy, AdaptiveHaar(RESOLUTION))
    own = [noise_share(one.observation, RECEIVER.samples) * brightest_used(one.observation) for one in noisy]
    least, other = own[0], own[1] / found.scales.values[1]
    assert_close(found.trust, torch.stack([torch.ones_like(least), (least / other) ** 2]))
    assert found.trust[1] < 0.1
    assert found.estimate.noise is not None
    assert_close(found.estimate.noise, least / brightest_used(found.estimate.observation), rtol=1e-5, atol=0)
    assert_close(found.estimate.observation.weights[RECEIVER.points :], used(1) * found.trust[1])


def test_a_photograph_that_the_light_does_not_explain_counts_less() -> None:
    """A block that stands elsewhere than its scene says, beside one that stands where it should."""
    misplaced = View(scene(1), photographed(2, 0.6, 0.01))
    found = joint([views()[0], misplaced], AdaptiveHaar(RESOLUTION))
    plain = joint(views(), AdaptiveHaar(RESOLUTION))
    assert found.trust[0] == 1.0
    assert found.trust[1] < 0.3
    assert_close(plain.trust, torch.ones(2, dtype=torch.float64), rtol=0, atol=0.3)


def test_two_equal_photographs_are_trusted_as_one_of_half_the_variance() -> None:
    alone = explain(photographed(0, 1.0), scene(0), transfer(0), BASIS, NNLS())
    measured = single_confidence(alone, scene(0), transfer(0), NNLS()).confidence
    assert measured is not None
    quieter = replace(alone, noise=alone.observation.samples.new_tensor(measured.noise / math.sqrt(2)))
    expected = single_confidence(quieter, scene(0), transfer(0), NNLS()).confidence
    pair = [View(scene(0), photographed(0, 1.0), 1.0)] * 2
    poses = side_by_side([scene(0)] * 2, [transfer(0)] * 2, NNLS())
    both = with_confidence(explain_together(pair, poses, BASIS, NNLS()), poses, NNLS()).estimate.confidence
    assert expected is not None
    assert both is not None
    assert both.noise == pytest.approx(measured.noise)
    assert_close(both.observability, expected.observability, rtol=1e-5, atol=1e-7)
    assert_close(both.deviation, expected.deviation, rtol=1e-4, atol=0)
    assert both.deviation.isfinite().double().mean() > 0.5


def test_the_noisier_photograph_adds_less_to_what_is_determined() -> None:
    def degrees(noise: float) -> float:
        second = replace(photographed(1, 1.0, noise), weights=used(1))
        pair = [View(scene(0), photographed(0, 1.0, 0.003), 1.0), View(scene(1), second, 1.0)]
        poses = side_by_side([scene(0), scene(1)], [transfer(0), transfer(1)], NNLS())
        found = with_confidence(explain_together(pair, poses, BASIS, NNLS()), poses, NNLS()).estimate.confidence
        assert found is not None
        return found.degrees_of_freedom

    assert degrees(0.003) > degrees(0.1) + 1


def test_a_foreign_shadow_is_let_go_of() -> None:
    """Kept, it costs all that the second photograph adds: its noise is taken as large and its exposure is wrong."""
    clean, spoiled = views(), views()
    stripe = torch.arange(RECEIVER.points) % RECEIVER.samples[0] == 16
    samples = spoiled[1].observation.samples.clone()
    samples[:, stripe] *= 0.3
    spoiled[1] = View(scene(1), Observation(samples, used(1)))
    poses = side_by_side([scene(0), scene(1)], [transfer(0), transfer(1)], NNLS())
    plain = explain_together(spoiled, poses, BASIS, NNLS())
    found = explain_together_robustly(spoiled, poses, BASIS, NNLS())
    assert (found.views[1].observation.rejections[stripe] == Rejection.ROBUST).double().mean() > 0.9
    assert (found.views[1].observation.weights[stripe] == 0).double().mean() > 0.9
    kept = found.estimate.observation.rejections.split(RECEIVER.points)
    assert torch.equal(kept[1], found.views[1].observation.rejections)
    wanted = explain_together(clean, poses, BASIS, NNLS())
    harm, rest = (on_third(item.estimate.solution.coefficients) for item in (plain, found))
    best = on_third(wanted.estimate.solution.coefficients)
    assert harm > 1.2 * best
    assert rest - best < 0.1 * (harm - best)
    assert plain.scales.values[1].item() < 0.59
    assert_close(found.scales.values[1].item(), 0.6, rtol=4 * found.scales.deviations[1].item(), atol=0)
    assert plain.scales.noise[1] > 10 * wanted.scales.noise[1]
    assert_close(found.scales.noise, wanted.scales.noise, rtol=0.05, atol=0)


def test_columns_of_poses_stand_side_by_side_at_every_level() -> None:
    """Dense ones, and those cast on demand."""
    settings = AdaptiveHaar(4 * RESOLUTION)
    scenes, transfers = [scene(0), scene(1)], [transfer(0), transfer(1)]
    columns = side_by_side(scenes, transfers, settings).columns
    assert not isinstance(columns, Transfer)
    squares = torch.tensor([0, 40, columns.tree.size - 5])
    alone = [side_by_side([one], [part], settings).columns for one, part in zip(scenes, transfers, strict=True)]
    parts = [part.of(squares) for part in alone if not isinstance(part, Transfer)]
    assert_close(columns.of(squares), torch.cat(parts, dim=1), rtol=0, atol=0)
    assert parts[0].shape == (3, RECEIVER.points)


def test_adaptive_haar_from_rectified_photographs(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    """The public door: linear pictures and scenes in, one light out, in the dtype of the pictures."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path))
    pictures = [receiver_image(truth(k) * EXPOSURES[k], RECEIVER).float() for k in (0, 1)]
    found = estimate_together([pictures[0], linear_photo(pictures[1])], [scene(0), scene(1)])
    assert found.scales.values[1].item() == pytest.approx(0.6, rel=1e-2)
    assert found.estimate.solution.coefficients.dtype == torch.float32
    assert found.estimate.refinement is not None
    assert found.estimate.light.nonnegative
    assert found.rms_255.max() < 3


def test_scales_follow_the_unit_that_is_given() -> None:
    one, other = joint(views((1.0, None))), joint(views((4.0, None)))
    assert_close(other.scales.values, 4 * one.scales.values)
    assert_close(other.predicted[1], one.predicted[1], rtol=1e-6, atol=1e-8)
    assert_close(other.estimate.light.radiance, one.estimate.light.radiance / 4, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("scale", [0.0, -1.0, math.inf, math.nan])
def test_exposures_that_cannot_be(scale: float) -> None:
    with pytest.raises(ConfigError, match="photograph 2: its exposure must be a positive number"):
        joint(views((None, scale)))


def test_one_photograph_is_not_joint() -> None:
    with pytest.raises(ConfigError, match="at least two photographs, got 1; use estimate"):
        joint(views()[:1])


def test_lengths_in_different_units() -> None:
    first, second = views()
    with pytest.raises(SceneError, match="different units, cm and unit"):
        joint([first, replace(second, scene=replace(second.scene, units="cm"))])


def test_a_reference_that_changes_the_level_does_not_go_with_a_stated_exposure() -> None:
    first, second = views((None, 0.6))
    with pytest.raises(ConfigError, match="photograph 2: reference smooth changes its level"):
        joint([first, replace(second, scene=replace(second.scene, reference="smooth"))])
