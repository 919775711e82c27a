"""A light made even where its photograph does not tell: what the plane shows stays, what is wild goes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.confidence import pixel_texels
from torchlight.errors import SceneError
from torchlight.evenness import evened, finer, texel_means, told, unexplained, with_means
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light_plane import LightPlane
from torchlight.photo.observation import linear_photo
from torchlight.precomputation import precompute
from torchlight.relighting import relight
from torchlight.synthetic import block_scene

SAMPLES = (24, 24)
SCENE = block_scene(Block((1.0, 0.6, 1.2), rotation_degrees=20.0), Receiver((0.0, 0.0), (4.0, 4.0), SAMPLES))
ROWS = 128


def pictured(scene: Scene, light: EnvironmentMap, noise: float) -> Tensor:
    """A rectified photograph."""
    picture = relight(scene, light, 4096).reshape(3, *SAMPLES).flip(1)
    generator = torch.Generator().manual_seed(3)
    return picture + noise * picture.max() * torch.randn(picture.shape, generator=generator)


def smooth_sky() -> EnvironmentMap:
    rows = torch.linspace(0.6, 1.4, ROWS // 2)[:, None].expand(-1, 2 * ROWS)
    sky = torch.zeros(3, ROWS, 2 * ROWS)
    sky[:, : ROWS // 2] = rows * torch.tensor([1.0, 0.8, 0.6])[:, None, None]
    return EnvironmentMap(sky)


def test_texels_get_the_means_that_are_asked_for() -> None:
    generator = torch.Generator().manual_seed(1)
    radiance = torch.rand(3, ROWS, 2 * ROWS, generator=generator).double()
    before = texel_means(radiance, 16)
    after = before * (0.5 + torch.rand(before.shape, generator=generator).double())
    changed = with_means(radiance, before, after)
    assert_close(texel_means(changed, 16), after)
    assert_close(changed[:, ROWS // 2 :], radiance[:, ROWS // 2 :])  # below the plane
    assert bool((changed >= 0).all())


def test_even_light_is_added_and_taken_away_but_no_more_than_there_is() -> None:
    """One texel of a floor of 1 with a peak of 9: down by 0.4 all fall as much; further, the floor ends at 0."""
    radiance = torch.zeros(3, ROWS, 2 * ROWS, dtype=torch.float64)
    index = pixel_texels(8, ROWS)
    row, column = (index == 150).nonzero()[3].tolist()
    radiance[:, : ROWS // 2] = torch.where(index == 150, 1.0, 0.0)
    radiance[:, row, column] = 9.0
    before = texel_means(radiance, 8)
    peaks, floors = [], []
    for share in (0.4, -0.4, 0.02 - before[0, 150].item()):
        after = before.clone()
        after[:, 150] += share
        changed = with_means(radiance, before, after)
        assert_close(texel_means(changed, 8), after)
        peaks.append(changed[0, row, column].item())
        floors.append(changed[0, : ROWS // 2][(index == 150) & (radiance[0, : ROWS // 2] == 1)].unique().tolist())
    assert peaks[:2] == pytest.approx([9.4, 8.6])
    assert floors[0] == pytest.approx([1.4])
    assert floors[1] == pytest.approx([0.6])
    assert floors[2] == [0.0]
    assert 0.0 < peaks[2] < 9.0


def test_a_small_map_gets_enough_pixels_for_every_texel() -> None:
    light = finer(EnvironmentMap(torch.full((3, 12, 24), 2.0)))
    assert light.height >= ROWS
    assert_close(texel_means(light.radiance, 16), torch.full((3, 768), 2.0, dtype=torch.float64))


def test_a_wild_horizon_is_evened_and_the_photograph_is_still_explained() -> None:
    sky = smooth_sky()
    photo = pictured(SCENE, sky, 0.005)
    true = texel_means(sky.radiance, 8)
    wrong = true.clone()
    wrong[:, 26:30] *= 8.0  # of the row of face +x that ends at the horizon: cosines below 0.25
    wild = with_means(sky.radiance, true, wrong)
    found = evened(photo, SCENE, EnvironmentMap(wild), precompute(SCENE, 8, use_cache=False))
    off, left = ((texel_means(r, 8) - true).square().mean().sqrt() for r in (wild, found.radiance))
    assert float(left) < 0.4 * float(off)
    shown, seen = relight(SCENE, found, 4096), relight(SCENE, sky, 4096)
    assert float((shown - seen).square().mean().sqrt()) < 0.005 * float(seen.max())


def test_a_light_that_would_explain_the_photograph_worse_is_left_as_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sky = smooth_sky()
    photo = pictured(SCENE, sky, 0.005)
    monkeypatch.setattr("torchlight.evenness.even_light", lambda facts, scales: 2 * facts.start)
    assert evened(photo, SCENE, sky, precompute(SCENE, 8, use_cache=False)) is sky


@pytest.mark.parametrize(("left", "passes", "kept"), [([3.0, 1.9], 4, False), ([3.0, 3.0, 3.0], 5, True)])
def test_passes_go_on_until_the_photograph_is_explained(
    left: list[float], passes: int, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    unexplained_then = iter([1.0, *left])
    monkeypatch.setattr("torchlight.evenness.even_light", lambda facts, scales: facts.start)
    monkeypatch.setattr("torchlight.evenness.unexplained", lambda *given: next(unexplained_then))
    sky, counted = smooth_sky(), []
    photo, transfer = torch.ones(3, *SAMPLES), precompute(SCENE, 8, use_cache=False)
    found = evened(photo, SCENE, sky, transfer, lambda *done: counted.append(done))
    assert (found is sky) == kept
    assert counted[-1] == (3 * passes, 3 * passes)
    assert list(unexplained_then) == []


def test_detail_within_texels_keeps_explaining_the_photograph() -> None:
    """One pass leaves six times as much: where pixels end at 0, less than even light is taken away."""
    sky = smooth_sky()
    sky.radiance[:, 40:60, 10:14] += 100.0  # a narrow window near the horizon
    photo = pictured(SCENE, sky, 0.001)
    found = evened(photo, SCENE, sky, precompute(SCENE, 8, use_cache=False))
    linear = linear_photo(photo)
    assert found is not sky
    assert unexplained(linear, SCENE, found) < 1.9 * unexplained(linear, SCENE, sky)


def test_where_rounding_leaves_no_answer_the_light_is_left_as_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def indefinite(facts: object, scales: object) -> Tensor:
        return torch.linalg.cholesky(-torch.eye(2))

    monkeypatch.setattr("torchlight.evenness.even_light", indefinite)
    sky = smooth_sky()
    assert evened(pictured(SCENE, sky, 0.005), SCENE, sky, precompute(SCENE, 8, use_cache=False)) is sky


def test_progress_counts_channels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchlight.evenness.even_light", lambda facts, scales: facts.start)
    sky, counted = smooth_sky(), []
    photo, transfer = pictured(SCENE, sky, 0.0), precompute(SCENE, 8, use_cache=False)
    evened(photo, SCENE, sky, transfer, lambda *done: counted.append(done))
    assert counted == [(done, 9) for done in range(1, 10)]


def test_the_even_sky_lights_the_plane_as_much_as_the_light_that_was_found() -> None:
    """Where nothing stands in the way E = pi l."""
    sky = smooth_sky()
    empty = replace(SCENE, triangles=SCENE.triangles[:0])
    facts = told(linear_photo(pictured(empty, sky, 0.0)), empty, sky, precompute(empty, 8, use_cache=False), sky)
    levels = torch.tensor([channel.level for channel in facts])
    assert_close(levels, irradiance(sky).float() / torch.pi, rtol=5e-3, atol=0)  # texels of 12 degrees


def test_a_light_that_stands_near_or_is_negative_is_refused() -> None:
    sky = smooth_sky()
    photo = torch.ones(3, *SAMPLES)
    with pytest.raises(SceneError, match="stands near; use it as it is"):
        evened(photo, SCENE, replace(sky, plane=LightPlane(3.0, (0.0, 0.0))))
    with pytest.raises(SceneError, match="negative somewhere"):
        evened(photo, SCENE, EnvironmentMap(sky.radiance - 1, nonnegative=False))
