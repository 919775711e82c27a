"""For programs that follow OpenEXR's own convention: a lat-long with the attribute `envmap`, and a reader for it."""

from __future__ import annotations

from collections.abc import Sequence

from torchlight.export.handover import AXES, Handover, python_reader
from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp

SCRIPT = '''"""Reads the light: pip install OpenEXR.

    from {module} import radiance
    radiance([[0.0, 0.0, 1.0]])  # from the zenith

{header}
"""

from pathlib import Path

import numpy as np
import OpenEXR

PICTURE = Path(__file__).resolve().with_name("{picture}")
STRENGTH = {strength}  # multiplies picture and lamps
# direction towards the lamp; irradiance on a plane that faces it, red, green, blue; diameter in degrees
LAMPS = {lamps}


def pixels():
    """Returns the picture, [rows, columns, 3]."""
    with OpenEXR.File(str(PICTURE), separate_channels=True) as file:
        return np.stack([file.channels()[name].pixels for name in "RGB"], axis=-1)


def radiance(directions):
    """Returns red, green, blue from unit directions of torchlight's world, [points, 3]; lamps are not in it."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    picture = STRENGTH * pixels()
    rows, columns = picture.shape[:2]
    # OpenEXR's frame is (x, z, -y): the middle of the picture looks along its +Z, the left quarter along +X
    row = np.arccos(np.clip(z, -1, 1)) / np.pi * rows
    column = (0.5 - np.arctan2(x, -y) / (2 * np.pi)) * columns
    return picture[np.minimum(row.astype(int), rows - 1), column.astype(int) % columns]
'''


def openexr(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture and its reader. Negative radiance is kept.

    Args:
        light: without the lamps.
        lamps: listed in the reader.
        strength: written into the reader.
    """
    axes = f"The picture has Y up and looks along +Z: OpenEXR's (x, y, z) is (x, z, -y) of world axes that are {AXES}."
    pictures, texts = python_reader(light, lamps, strength, "openexr", SCRIPT, axes)
    return Handover(pictures, texts, "from light_openexr import radiance")
