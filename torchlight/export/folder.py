"""What `torchlight export` writes: one folder, complete or absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlight.export.handover import Handover
from torchlight.io.atomic import partial_folder, write_atomically
from torchlight.io.exr import write_exr
from torchlight.results import write_json

LAMPS = "lamps.json"


def write_export(
    folder: Path, handovers: Sequence[Handover], lamps: Mapping[str, Any], overwrite: bool = False
) -> None:
    """Writes the files of every target, and lamps.json.

    Raises:
        FormatError: the folder exists and `overwrite` is False, or it cannot be written.
    """
    with partial_folder(folder, overwrite=overwrite) as partial:
        for handover in handovers:
            for name, picture in handover.pictures.items():
                metadata = dict(picture.metadata)
                write_exr(partial / name, picture.pixels, metadata, openexr_envmap=picture.openexr_envmap)
            for name, text in handover.texts.items():
                write_atomically(partial / name, text.encode())
        write_json(partial / LAMPS, lamps)
