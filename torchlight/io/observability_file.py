"""How much of the light a photograph, or a scene, determines: the map R_ii in the files that hold it."""

from __future__ import annotations

from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.io.exr import read_channel, read_exr

CONFIDENCE, OBSERVABILITY = "confidence.exr", "observability.exr"  # of an estimate, of torchlight analyze


def read_observability(path: Path) -> Float[Tensor, "height width"]:
    """Returns R_ii of a file, or of a folder that holds one: 1 = determined, 0 = not at all.

    Raises:
        FormatError: there is no such file, or it is no such map.
    """
    file = observability_beside(path) if path.is_dir() else path
    if file is None:
        raise FormatError(f"{path}: holds neither {CONFIDENCE} nor {OBSERVABILITY}; torchlight estimate writes the one")
    observability = read_channel(file, "observability") if file.name == CONFIDENCE else _of_analysis(file)
    if observability.shape[1] != 2 * observability.shape[0]:
        height, width = observability.shape
        raise FormatError(f"{file}: an observability map is twice as wide as high, this one is {width} x {height}")
    return observability


def _of_analysis(file: Path) -> Float[Tensor, "height width"]:
    image, metadata = read_exr(file)
    if not str(metadata.get("R", "")).startswith("resolution"):
        raise FormatError(f"{file}: not an observability map; name the {OBSERVABILITY} of torchlight analyze")
    return image[0]


def observability_beside(folder: Path) -> Path | None:
    """Returns the map in a folder, that of an estimate before that of `torchlight analyze`; None without one."""
    found = (folder / name for name in (CONFIDENCE, OBSERVABILITY))
    return next((path for path in found if path.is_file()), None)
