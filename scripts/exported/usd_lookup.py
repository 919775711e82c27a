"""Opens an exported stage with usd-core and says, as JSON, what it means for a renderer.

    python usd_lookup.py JOB.json

Directions of the stage are taken into the dome's own frame; a lat-long of OpenEXR's kind then names the place in the
picture: middle +Z, left quarter +X, Y up.
"""

# pyright: reportMissingImports=false

import json
import math
import sys
from pathlib import Path

from pxr import Gf, Usd, UsdGeom, UsdLux


def place(direction, matrix):
    """Returns (u, v) in the picture of a direction of the stage; v = 0 is the top row."""
    x, y, z = matrix.GetInverse().TransformDir(Gf.Vec3d(*direction))
    return 0.5 - math.atan2(x, z) / (2 * math.pi), math.acos(max(-1.0, min(1.0, y))) / math.pi


def main(job):
    """Prints the answer."""
    stage = Usd.Stage.Open(str(Path(job["folder"]) / "light.usda"))
    cache = UsdGeom.XformCache()
    prims = list(stage.Traverse())
    dome = UsdLux.DomeLight(next(it for it in prims if it.IsA(UsdLux.DomeLight)))
    matrix = cache.GetLocalToWorldTransform(dome.GetPrim())
    lamps = [
        {
            "direction": list(cache.GetLocalToWorldTransform(it).TransformDir(Gf.Vec3d(0, 0, 1))),
            "diameter_degrees": UsdLux.DistantLight(it).GetAngleAttr().Get(),
            "irradiance": [
                UsdLux.LightAPI(it).GetIntensityAttr().Get() * c for c in UsdLux.LightAPI(it).GetColorAttr().Get()
            ],
            "normalized": UsdLux.LightAPI(it).GetNormalizeAttr().Get(),
        }
        for it in prims
        if it.IsA(UsdLux.DistantLight)
    ]
    answer = {
        "version": ".".join(map(str, Usd.GetVersion())),
        "up": UsdGeom.GetStageUpAxis(stage),
        "format": dome.GetTextureFormatAttr().Get(),
        "picture": dome.GetTextureFileAttr().Get().resolvedPath,
        "places": [place(direction, matrix) for direction in job["directions"]],
        "lamps": lamps,
    }
    print(json.dumps(answer))


main(json.loads(Path(sys.argv[-1]).read_text()))
