"""Observability maps as files: which are read, and what of others is said."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from torchlight.errors import FormatError
from torchlight.io.exr import write_channels, write_exr
from torchlight.io.observability_file import observability_beside, read_observability

SHARE = torch.linspace(0, 1, 128).reshape(8, 16)


def test_of_an_estimate_before_that_of_an_analysis(tmp_path: Path) -> None:
    write_exr(tmp_path / "observability.exr", 1 - SHARE[None], {"R": "resolution matrix"})
    assert read_observability(tmp_path).equal(1 - SHARE)
    write_channels(tmp_path / "confidence.exr", {"observability": SHARE}, {})
    assert read_observability(tmp_path).equal(SHARE)
    assert observability_beside(tmp_path) == tmp_path / "confidence.exr"


def test_a_folder_without_one(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"holds neither confidence.exr nor observability.exr"):
        read_observability(tmp_path)


@pytest.mark.parametrize(("name", "channel"), [("confidence.exr", "observability"), ("observability.exr", "Y")])
def test_a_map_that_is_no_latlong(tmp_path: Path, name: str, channel: str) -> None:
    write_channels(tmp_path / name, {channel: SHARE[:, :15]}, {"R": "resolution matrix"})
    with pytest.raises(FormatError, match=r"twice as wide as high, this one is 15 x 8"):
        read_observability(tmp_path / name)
