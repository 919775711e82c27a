"""Pictures that a command is about to write: said to be impossible before the work, not after it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from torchlight.errors import FormatError
from torchlight.io.atomic import check_writable


def check_outputs(paths: Iterable[Path], overwrite: bool) -> None:
    """Raises FormatError where a file cannot be written: no folder, no permission, or already there."""
    for path in paths:
        if not path.parent.is_dir():
            raise FormatError(f"{path}: there is no folder {path.parent}; make it, or choose another --out")
        check_writable(path.parent)
        if path.is_dir():
            raise FormatError(f"{path}: is a folder; choose another --out")
        if path.exists() and not overwrite:
            raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")
