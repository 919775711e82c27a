"""Loads exported light with skylibs and says, as JSON, where its own lookups find what.

python skylibs_lookup.py JOB.json
"""

# pyright: reportMissingImports=false

import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np


def main(job):
    """Prints radiance by direction, and the direction and radiance of some pixels by skylibs' own pixel2world."""
    sys.path.insert(0, job["folder"])
    from light_skylibs import load, radiance

    light = load()
    rows, columns = light.data.shape[:2]
    random = np.random.default_rng(0)
    row, column = random.integers(0, rows, 500), random.integers(0, columns, 500)
    x, y, z, _ = light.pixel2world(column, row)
    answer = {
        "version": version("skylibs"),
        "radiance": radiance(light, job["directions"]).tolist(),
        "pixel_directions": np.stack([x, -z, y], axis=-1).tolist(),
        "pixel_radiance": light.data[row, column].tolist(),
        "solid_angle": float(light.solidAngles().sum()),
    }
    print(json.dumps(answer))


main(json.loads(Path(sys.argv[-1]).read_text()))
