"""HDR-FLIP is handed the right pictures; where flip-evaluator is installed, its answers are what they should be."""

from __future__ import annotations

import sys

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light_metrics.flip import hdr_flip


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(ConfigError, match=r"pip install 'torchlight\[flip\]'"):
        hdr_flip(torch.ones(3, 4, 8), torch.ones(3, 4, 8))


def test_flip_of_real_pictures() -> None:
    pytest.importorskip("flip_evaluator", reason="needs the extra flip: pip install 'torchlight[flip]'")
    reference = torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.1
    assert hdr_flip(reference, reference).mean == pytest.approx(0, abs=1e-6)
    slight, strong = (hdr_flip(reference * factor, reference) for factor in (1.05, 2.0))
    assert 0 < slight.mean < strong.mean < 1
    assert strong.errors.shape == (16, 32)
    assert float(strong.errors.mean()) == pytest.approx(strong.mean, rel=1e-4)  # FLIP's own sum is float32
    left = reference.clone()
    left[..., :4] *= 8
    assert_close(hdr_flip(left, reference).errors[:, 16:], torch.zeros(16, 16), atol=1e-3, rtol=0)
    with pytest.raises(ConfigError, match="black"):
        hdr_flip(reference, 0 * reference)
