"""Where tests find real photographs and probes, which the repository does not hold."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def data_path(*parts: str) -> Path:
    """Returns a path below the folder that TORCHLIGHT_DATA names; skips the test where it does not exist."""
    root = os.environ.get("TORCHLIGHT_DATA")
    if root is None:
        pytest.skip(f"real data needed: set TORCHLIGHT_DATA to a folder that holds {'/'.join(parts)}")
    path = Path(root).joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no {'/'.join(parts)} in {root}, the folder that TORCHLIGHT_DATA names")
    return path
