"""The paper's experiments: both ground truths, what is chosen on the photograph, and the tables."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.quadtree import quadtree
from torchlight.inversion.refinement import Refinement, constants
from torchlight.light import haar
from torchlight.light.bases import SphericalHarmonics, Texels
from torchlight.light.directions import to_y_up
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light.procedural import sun_and_window
from torchlight.light.synthesis import synthesize
from torchlight.photo.observation import Observation
from torchlight.solvers import Ridge
from torchlight.synthetic import block_scene, block_values, pixel_rays
from torchlight.transfer import Transfer, transport

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
harmonics, measure, methods, mitsuba_truth, setting, tables, truth = (
    import_module(f"paper.{name}")
    for name in ("harmonics", "measure", "methods", "mitsuba_truth", "setting", "tables", "truth")
)
BLOCK = Block((1.0, 0.6, 1.2), rotation_degrees=69.0, translation=(0.3, 0.2))
SMALL = Receiver((0.0, 0.0), (4.0, 4.0), (16, 16))


def some_map(height: int, seed: int = 0) -> EnvironmentMap:
    return EnvironmentMap(torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(seed)) ** 8)


# --- Mitsuba's light -----------------------------------------------------------------------------------------------


def as_mitsuba_interpolates(image: np.ndarray, directions: Tensor) -> Tensor:
    """Returns bilinear radiance, row r at theta = pi r / (H - 1) and column c at (c + 1/2) / W, as Mitsuba has it."""
    x, y, z = to_y_up(directions).unbind(dim=-1)
    rows, columns, _ = image.shape
    row = torch.atan2(torch.hypot(x, z), y) / torch.pi * (rows - 1)
    column = torch.atan2(x, -z) / (2 * torch.pi) * columns - 0.5
    r, c = row.floor().clamp(max=rows - 2).long(), column.floor().long()
    picture = torch.from_numpy(image).double()
    total = torch.zeros(len(directions), 3, dtype=torch.float64)
    for down, row_part in ((0, 1 - (row - r)), (1, row - r)):
        for right, column_part in ((0, 1 - (column - c)), (1, column - c)):
            total += picture[r + down, (c + right) % columns] * (row_part * column_part)[:, None]
    return total


def test_mitsuba_s_interpolation_of_the_finer_map_is_the_map() -> None:
    light = some_map(8)
    image = mitsuba_truth.constant_per_pixel(light)
    generator = torch.Generator().manual_seed(3)
    row = torch.randint(0, 4, (500,), generator=generator)
    column = torch.randint(0, 16, (500,), generator=generator)
    inside = 0.02 + 0.96 * torch.rand(500, 2, generator=generator, dtype=torch.float64)
    theta = (row + inside[:, 0]) * torch.pi / 8
    phi = torch.pi * (1 - (column + inside[:, 1]) / 8)
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], dim=-1)
    assert_close(as_mitsuba_interpolates(image, directions), light.radiance[:, row, column].T.double())


def test_the_finer_map_keeps_the_irradiance_and_is_black_below(monkeypatch: pytest.MonkeyPatch) -> None:
    light = some_map(8)
    monkeypatch.setattr(mitsuba_truth, "FINE_ROWS", 256)  # coarse, so that a shift by half a row would show
    image = mitsuba_truth.constant_per_pixel(light)
    n, turns = 512, 160
    theta = (torch.arange(n, dtype=torch.float64) + 0.5) * torch.pi / 2 / n
    phi = (torch.arange(turns, dtype=torch.float64)[:, None] + 0.5) * 2 * torch.pi / turns
    x, y = theta.sin() * phi.cos(), theta.sin() * phi.sin()
    directions = torch.stack([x, y, theta.cos().expand_as(x)], dim=-1).flatten(end_dim=1)
    radiance = as_mitsuba_interpolates(image, directions).unflatten(0, (turns, n))
    total = (theta.sin() * theta.cos()) @ radiance.sum(dim=0) * (torch.pi / 2 / n) * (2 * torch.pi / turns)
    assert_close(total, irradiance(light).double(), rtol=1e-3, atol=0)
    assert not image[image.shape[0] // 2 + 1 :].any()


def test_the_two_truths_agree() -> None:
    if not mitsuba_truth.installed():
        pytest.skip("Mitsuba 3 is not installed")
    light = sun_and_window(64)
    exact = block_values(BLOCK, SMALL, pixel_rays(light))
    rendered = mitsuba_truth.block_renderer(SMALL, light, 2025)(BLOCK)
    used = visible_samples(block_scene(BLOCK, SMALL)).double()
    assert metrics.rms_255(rendered, exact, used).item() < 0.5  # of which the renderer's noise is most
    bias = ((rendered - exact) * used).sum(dim=1) / used.sum() / exact[:, used > 0].max() * 255
    assert float(bias.abs().max()) < 0.05


# --- stored truths -------------------------------------------------------------------------------------------------


def test_a_truth_is_computed_once_per_light_pose_and_version(tmp_path: Path) -> None:
    calls: list[Block] = []

    def make(_light: EnvironmentMap) -> Any:
        def values(block: Block) -> Tensor:
            calls.append(block)
            return torch.full((3, 4), float(len(calls)), dtype=torch.float64)

        return values

    light = some_map(4)
    first = truth.stored(light, "x", tmp_path, "1", make)
    assert len(calls) == len(setting.POSES) == len(list(tmp_path.iterdir()))
    assert_close(truth.stored(light, "other name", tmp_path, "1", make), first, rtol=0, atol=0)
    assert len(calls) == len(setting.POSES)
    truth.stored(some_map(4, seed=1), "x", tmp_path, "1", make)
    truth.stored(light, "x", tmp_path, "2", make)
    assert len(calls) == 3 * len(setting.POSES)


def test_without_mitsuba_the_analytic_truth_is_taken_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(truth, "installed", lambda: False)
    assert truth.available(None) is truth.Truth.ANALYTIC
    assert len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(SystemExit, match="--truth mitsuba needs Mitsuba 3"):
        truth.available(truth.Truth.MITSUBA)
    assert truth.available(truth.Truth.ANALYTIC) is truth.Truth.ANALYTIC


def test_agreement_is_in_255ths_of_the_brightest() -> None:
    exact = torch.full((5, 3, 4096), 0.5, dtype=torch.float64)
    rows = truth.agreement("x", exact * (1 + 1 / 255), exact)
    assert [row.pose for row in rows] == [setting.pose_name(k) for k in range(5)]
    for row in rows:
        assert (row.rms, row.largest) == pytest.approx((1.0, 1.0), rel=1e-6)


# --- the photograph ------------------------------------------------------------------------------------------------


def test_noise_is_a_share_of_the_brightest_and_always_the_same() -> None:
    values = torch.full((5, 3, 4096), 0.3, dtype=torch.float64)
    values[0, :, ::2] = 0.15
    clean, noisy, again = (setting.exposed(values, noise) for noise in (0.0, 0.02, 0.02))
    assert_close(noisy.photo.samples, again.photo.samples, rtol=0, atol=0)
    difference = (noisy.photo.samples - clean.photo.samples)[:, ::2]
    assert difference.std().item() == pytest.approx(0.02 * 250 / 255, rel=0.01)
    assert clean.photo.samples[:, 1].tolist() == pytest.approx([250 / 255] * 3)
    for a, b in zip(noisy.truth, clean.truth, strict=True):
        assert_close(a.samples, b.samples, rtol=0, atol=0)


@pytest.mark.parametrize("named", [True, False])
def test_missing_probes_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: bool) -> None:
    monkeypatch.delenv("TORCHLIGHT_DATA", raising=False)
    (tmp_path / "probes").mkdir()
    (tmp_path / "probes" / "kitchen_cross.hdr").touch()
    with pytest.raises(SystemExit) as caught:
        setting.probe_files(tmp_path if named else None, None)
    assert len(str(caught.value).splitlines()) == 1
    assert "campus_cross.hdr" in str(caught.value)
    assert ("kitchen_cross.hdr" in str(caught.value)) is not named
    with pytest.raises(SystemExit, match=r"no \.hdr or \.exr"):
        setting.probe_files(None, tmp_path)
    assert [path.name for path in setting.probe_files(None, tmp_path / "probes")] == ["kitchen_cross.hdr"]


# --- spherical harmonics -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small() -> Transfer:
    return transport(block_scene(BLOCK, SMALL), 16, 2)


@pytest.fixture
def photo(small: Transfer, monkeypatch: pytest.MonkeyPatch) -> Observation:
    """A photograph under light of degree 3 on the small receiver, with a sample that must not count."""
    monkeypatch.setattr(harmonics, "RECEIVER", SMALL)
    matrix = small.project(SphericalHarmonics(3, 16))
    coefficients = torch.randn(3, 16, generator=torch.Generator().manual_seed(4))
    weights = visible_samples(block_scene(BLOCK, SMALL)).float()
    samples = coefficients @ matrix.T
    return Observation(torch.where(weights > 0, samples, torch.nan), weights)


@pytest.mark.parametrize("degree", [3, 5])
def test_the_objective_is_numpy_s(small: Transfer, photo: Observation, degree: int) -> None:
    noise = 0.1 * torch.randn(photo.samples.shape, generator=torch.Generator().manual_seed(5))
    seen = Observation((photo.samples + noise).nan_to_num(), photo.weights)
    assert harmonics.lstsq_difference(small.project(SphericalHarmonics(degree, 16)), seen) < 1e-8


def test_the_degree_chosen_is_that_of_the_light(small: Transfer, photo: Observation) -> None:
    noise = 0.02 * torch.randn(photo.samples.shape, generator=torch.Generator().manual_seed(6))
    basis, solver = harmonics.chosen_harmonics(small, Observation(photo.samples + noise, photo.weights))
    assert basis == SphericalHarmonics(3, 16)
    assert isinstance(solver, Ridge)


def test_quarters_are_disjoint_and_cover_the_receiver() -> None:
    parts = torch.stack(harmonics.quarters())
    assert parts.sum(dim=0).eq(1).all()
    assert parts.sum(dim=1).tolist() == [1024] * 4


# --- relighting and tables -----------------------------------------------------------------------------------------


def test_relighting_by_squares_is_the_light_s_own_shadow() -> None:
    """A bright texel in the second level below the transport, one at its level, and a whole face."""
    texels = torch.zeros(3, 3072, dtype=torch.float64)
    texels[0, 5 * 128 + 37] = 1.0
    texels[1, :2048].reshape(16, 4, 32)[6:8, 1, 10:12] = 2.0
    texels[2, 2048:] = 3.0
    coefficients = haar.analysis(texels, 32)
    kept = (coefficients != 0) | constants(quadtree(32))
    fate = torch.zeros(3, len(quadtree(32).supports))
    refinement = Refinement(kept, fate.long(), torch.zeros(3).long())
    exact = block_values(BLOCK, setting.RECEIVER, pixel_rays(synthesize(Texels(32), texels.float())))
    found = measure.relit_by_squares(measure.pose_columns(BLOCK, 32), coefficients, refinement) / torch.pi
    used = torch.ones(4096)
    for k in range(3):
        assert metrics.rms_255(found[k, None].float(), exact[k, None].float(), used).item() < 1.0


def row(method: str, family: Any, error: float) -> Any:
    return measure.Row(
        "kitchen_cross", method, family.value, 0.0, "", 9, None, 0.5, (error, error), 0.1, True, 1e-12, None
    )


def test_ratios_are_those_of_the_mean_errors() -> None:
    haar = row(methods.GAIN.name, methods.Family.HAAR, 0.5)
    sh = replace(row("SH", methods.Family.HARMONICS, 4.0), lstsq_difference=1e-12)
    noisy = replace(sh, noise=0.01, held_out=(9.0,))
    text = tables.report([haar, sh, noisy], [truth.Agreement("kitchen_cross", "photographed", 0.31, 1.0)])
    assert "| kitchen_cross | 8.0 | 2.3 |" in text  # 3.7 / 1.6 in the paper
    assert "noise of 0.01" in text
    assert "they DISAGREE" in text
    assert "as it should be" in text
    assert "not converged" not in text
    assert "1e-12, not converged" in tables.report([haar, replace(sh, converged=False)], [])
    assert "NOT as it should be" in tables.checks([replace(sh, lstsq_difference=1e-7)])


def test_the_methods_have_different_names_and_one_is_the_reference() -> None:
    names = [method.name for method in methods.METHODS]
    assert len(set(names)) == len(names)
    assert methods.GAIN in methods.METHODS
