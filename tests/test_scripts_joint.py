"""The judge of scripts/joint_gain.py: grain of its renderings is no error of the light."""

from __future__ import annotations

import math
import sys
from importlib import import_module
from pathlib import Path

import pytest
import torch

from torchlight.photo.observation import Observation

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
joint_gain = import_module("joint_gain")


def halves(grain: float) -> Observation:
    """A plane of brightness 1, one sample of it 2, rendered twice; the last sample is not to be used."""
    truth = torch.ones(3, 40_000, dtype=torch.float64)
    truth[:, 0] = 2.0
    drawn = torch.randn(2, *truth.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    drawn[..., 0] = 0
    weights = torch.ones(2, truth.shape[-1])
    weights[1, -1] = 0
    shown = truth + grain * drawn
    shown[..., -1] = 1e6
    return Observation(shown, weights)


@pytest.mark.parametrize("grain", [0.0, 0.05])
def test_grain_is_no_error(grain: float) -> None:
    """A prediction 1 % of the brightest sample too bright is 2.55 of 255 off, on grain of 2.5 times as much, too."""
    shown = torch.ones(3, 40_000, dtype=torch.float64) + 0.02
    shown[:, 0] = 2.02
    assert joint_gain.rms_without_grain(shown, halves(grain)) == pytest.approx(2.55, rel=0.03 if grain else 1e-9)


def test_both_are_better_only_where_they_beat_each() -> None:
    assert joint_gain.Scores(2.0, 1.0, 0.9).better
    assert not joint_gain.Scores(2.0, 1.0, 1.0).better
    assert not joint_gain.Scores(1.0, 2.0, math.nan).better
