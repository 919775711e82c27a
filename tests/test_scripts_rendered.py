"""The rendered photographs: the lens, the file, the truth, and the light that the block throws back in them."""

from __future__ import annotations

import math
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from torchlight.geometry.footprints import visible_samples
from torchlight.interreflection import bounced_transport
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.observing import observe
from torchlight.photo.observation import Observation, linear_photo
from torchlight.synthetic import block_values, pixel_rays

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
photographs, probes, measure, setting = (
    import_module(name) for name in ("rendered.photograph", "rendered.probes", "rendered.measure", "paper.setting")
)


@cache
def bench() -> Any:
    return measure.Bench()


def even_light() -> EnvironmentMap:
    return EnvironmentMap(torch.ones(3, 32, 64))


def test_the_lens_moves_every_pixel_to_where_its_ray_meets_the_pinhole_picture() -> None:
    rays = photographs.sensor_rays(probes.camera())
    pinhole = photographs.pinhole_around(rays, probes.camera())
    columns, rows = pinhole.size
    x = (torch.arange(columns, dtype=torch.float64) - pinhole.middle[0]) / pinhole.focal
    y = (torch.arange(rows, dtype=torch.float64) - pinhole.middle[1]) / pinhole.focal
    fine = torch.stack([x.expand(rows, -1), y[:, None].expand(-1, columns), torch.ones(rows, columns)])
    shown = photographs.through_the_lens(fine, rays, pinhole)
    assert_close(shown[:2], rays.mean(dim=2).permute(2, 0, 1), rtol=0, atol=1e-12)  # ramps pass without change
    assert_close(shown[2], torch.ones_like(shown[2]))


def test_the_file_is_srgb_with_the_noise_asked_for() -> None:
    grey = torch.full((3, 100, 100), 0.5)
    exact = photographs.stored(grey, 0.8, 0.0, 1)
    assert (exact == round(255 * (1.055 * 0.4 ** (1 / 2.4) - 0.055))).all()
    noisy = torch.from_numpy(photographs.stored(grey, 0.8, 0.01, 1)) / 255.0
    linear = ((noisy + 0.055) / 1.055) ** 2.4
    assert linear.mean().item() == pytest.approx(0.4, abs=5e-4)
    assert linear.std().item() == pytest.approx(0.01, rel=0.05)


def test_the_photograph_is_exposed_by_its_brightest_sample(tmp_path: Path) -> None:
    radiance = torch.full((2, 3, 300, 400), 3.0)
    taken = probes.take(probes.Rendering(radiance), setting.PHOTOGRAPHED, tmp_path / "photo.png")
    assert taken.exposure == pytest.approx(probes.EXPOSED / 3.0, rel=1e-5)
    assert taken.own_noise == 0.0
    seen = measure.shown(taken)
    used = seen.photo.weights > 0
    assert seen.photo.samples[:, used].mean().item() == pytest.approx(probes.EXPOSED, rel=0.01)
    assert 255 * seen.noise == pytest.approx(255 * 0.01 / 4, rel=0.5)  # a sample is the mean of a dozen pixels or so


@pytest.mark.parametrize("way", [measure.DEFAULT, measure.TEXELS, measure.HARMONICS])
def test_every_way_relights_poses_that_the_photograph_does_not_show(way: str) -> None:
    light, weights = sun_and_window(32), visible_samples(probes.scene(setting.PHOTOGRAPHED)).float()
    values = block_values(setting.PHOTOGRAPHED, setting.RECEIVER, pixel_rays(light))
    exposure = probes.EXPOSED / (probes.ALBEDO * values.max().item())
    photo = Observation((values * probes.ALBEDO * exposure).float(), weights)
    shown = measure.Shown(photo, torch.zeros_like(photo.samples), 0.002)
    row = measure.measured("sun", way, shown, measure.exposed_truth(light, exposure), bench())
    assert len(row.held_out) == len(probes.SCORED)
    assert max(row.held_out) < (30.0 if way == measure.HARMONICS else 2.5)  # a sun is too small for 25 harmonics
    assert measure.table([row]).count("\n") == 3


def test_the_renderer_s_block_throws_back_what_its_albedo_says(tmp_path: Path) -> None:
    if not photographs.installed():
        pytest.skip("Mitsuba 3 is not installed")
    rendered = probes.rendering(even_light(), setting.PHOTOGRAPHED, 8, tmp_path)
    here = probes.scene(setting.PHOTOGRAPHED)
    seen = observe(linear_photo(rendered.radiance), here)
    used = seen.weights > 0
    direct = block_values(setting.PHOTOGRAPHED, setting.RECEIVER, pixel_rays(even_light())) * probes.ALBEDO
    added = (seen.samples - direct)[:, used]
    share = bounced_transport(here, 8).sum(dim=1)[used] * probes.BLOCK_ALBEDO * probes.ALBEDO / math.pi
    factor = (added * share).sum() / (3 * share.square().sum())
    assert factor.item() == pytest.approx(1.0, abs=0.25)  # the grain alone moves it by 0.05
    assert added.square().mean().sqrt() < 0.03  # the shadow is where geometry has it, within the grain
