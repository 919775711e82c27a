"""The halo of local tone mapping: none under true shadows, found where one was made."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import LINEAR, RECTIFIED, png, scene_file
from workbench import torchlight as run

from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.photo.observation import Observation
from torchlight.photo.tone import HALO, halo, ring

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (64, 48))
POSITIONS = sample_centers(RECEIVER)


def shadowed(glow: float, penumbra: float = 0.1) -> Tensor:
    """A round shadow with a penumbra on a plane with a fall-off; `glow` brightens its surroundings."""
    x, y = POSITIONS.unbind(dim=-1)
    away = ((x + 0.3).square() + y.square()).sqrt() - 0.6
    light = 0.3 + 0.7 * ((away / penumbra + 1) / 2).clamp(0, 1)
    falloff = (0.1 * x - 0.05 * x * y - 0.03 * y * y).exp()
    return (falloff * light * (1 + glow * (-(away.clamp(min=0) / 0.3)).exp())).expand(3, -1)


def observed(values: Tensor) -> Observation:
    return Observation(values, torch.ones_like(values[..., 0, :]))


def test_a_true_shadow_has_none() -> None:
    for penumbra in (0.01, 0.1, 0.4):
        assert halo(observed(shadowed(0.0, penumbra)), POSITIONS, RECEIVER.samples).item() < 0.002


@pytest.mark.parametrize("glow", [0.08, 0.2])
def test_a_glow_is_found_and_grows(glow: float) -> None:
    found = halo(observed(shadowed(glow)), POSITIONS, RECEIVER.samples).item()
    assert HALO < found < glow


def test_each_photograph_of_a_batch_is_judged_alone() -> None:
    both = torch.stack([shadowed(0.0), shadowed(0.2)])
    found = halo(observed(both), POSITIONS, RECEIVER.samples)
    alone = [halo(observed(one), POSITIONS, RECEIVER.samples) for one in both]
    assert_close(found, torch.stack(alone))


def test_nothing_to_judge() -> None:
    for values in (torch.ones(3, RECEIVER.points), torch.zeros(3, RECEIVER.points)):
        assert math.isnan(halo(observed(values), POSITIONS, RECEIVER.samples).item())


def test_rings() -> None:
    marked = torch.zeros(7, 9, dtype=torch.bool)
    marked[3, 4] = True
    found = ring(marked.flatten(), (2, 3), (9, 7)).reshape(7, 9)
    rows, columns = torch.meshgrid(torch.arange(7) - 3, torch.arange(9) - 4, indexing="ij")
    distance = torch.maximum(rows.abs(), columns.abs())
    assert torch.equal(found, (distance >= 2) & (distance <= 3))


def test_the_command_line_warns_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    text = RECTIFIED.replace("[16, 16]", "[64, 48]").replace("[1, 0.6, 1.2]", "[0.1, 0.1, 0.1]")
    assert LINEAR in text
    options = ("--out", tmp_path / "out", "--method", "texels", "--resolution", 4)
    for glow, warned in ((0.0, False), (0.2, True)):
        image = 0.7 * shadowed(glow).reshape(3, 48, 64).flip(1).float()
        photo = png(tmp_path / f"{glow}.png", image)
        ran = run("estimate", scene_file(tmp_path, text), photo, *options)
        assert ran.code == 0
        assert ("local tone mapping" in ran.err) is warned
