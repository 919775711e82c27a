"""For skylibs (import envmap): a lat-long with Y up that looks along -Z, and its loader."""

from __future__ import annotations

from collections.abc import Sequence

from torchlight.export.handover import AXES, Handover, python_reader
from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp

SCRIPT = '''"""Loads the light: pip install skylibs.

    from {module} import load, radiance
    light = load()  # envmap.EnvironmentMap
    radiance(light, [[0.0, 0.0, 1.0]])  # from the zenith

{header}
"""

from pathlib import Path

import numpy as np
from envmap import EnvironmentMap

PICTURE = Path(__file__).resolve().with_name("{picture}")
STRENGTH = {strength}  # multiplies picture and lamps
# direction towards the lamp; irradiance on a plane that faces it, red, green, blue; diameter in degrees
LAMPS = {lamps}


def load():
    """Returns the picture as skylibs holds it."""
    light = EnvironmentMap(str(PICTURE), "latlong")
    light.data = STRENGTH * np.asarray(light.data)
    return light


def radiance(light, directions):
    """Returns red, green, blue from unit directions of torchlight's world, [points, 3]; lamps are not in it."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    u, v = light.world2image(x, z, -y)
    rows, columns = light.data.shape[:2]
    row = np.clip(np.floor(v * rows).astype(int), 0, rows - 1)
    return light.data[row, np.floor(u * columns).astype(int) % columns]
'''


def skylibs(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture and its loader. Negative radiance is kept.

    Args:
        light: without the lamps.
        lamps: listed in the loader.
        strength: written into the loader.
    """
    axes = f"The picture has Y up and looks along -Z: skylibs' (x, y, z) is (x, z, -y) of world axes that are {AXES}."
    pictures, texts = python_reader(light, lamps, strength, "skylibs", SCRIPT, axes)
    return Handover(pictures, texts, "from light_skylibs import load")
