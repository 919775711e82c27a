"""Where tests find real photographs and probes, which the repository does not hold."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def data_path(*parts: str) -> Path:
    """Returns a path below TORCHLIGHT_DATA or `../shared/data`; skips the test where it does not exist."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    root = Path(os.environ.get("TORCHLIGHT_DATA", default))
    path = root.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no {'/'.join(parts)} in {root}; set TORCHLIGHT_DATA to the data folder")
    return path
