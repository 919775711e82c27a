"""For USD: a stage with Z up, a DomeLight and DistantLights.

A DomeLight's picture follows OpenEXR, with its pole along +Y whatever the stage says, so the dome is turned by 90
degrees about X. A DistantLight shines along its own -Z; with `normalize` its intensity is the irradiance on a plane
that faces it.
"""

from __future__ import annotations

from collections.abc import Sequence

from torchlight.export.handover import (
    AXES,
    Handover,
    diameter_degrees,
    header,
    latlong_picture,
    nonnegative,
    number,
    numbers,
)
from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp

PICTURE, TEXT = "light_usd.exr", "light.usda"
STAGE = '''#usda 1.0
(
    doc = """{header}"""
    defaultPrim = "Light"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "Light"
{{
    def DomeLight "Environment"
    {{
        asset inputs:texture:file = @./{picture}@
        token inputs:texture:format = "latlong"
        float inputs:intensity = {strength}
        float inputs:exposure = 0
        float3 xformOp:rotateXYZ = (90, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }}
{lamps}}}
'''
DISTANT = """
    def DistantLight "Lamp_{place}"
    {{
        float inputs:angle = {diameter}
        color3f inputs:color = ({colour})
        float inputs:intensity = {intensity}
        float inputs:exposure = 0
        bool inputs:normalize = true
        matrix4d xformOp:transform = ( ({x}, 0), ({y}, 0), ({z}, 0), (0, 0, 0, 1) )
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
"""

Vector = tuple[float, float, float]


def usd(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture and the stage for USD.

    Args:
        light: without the lamps.
        lamps: to be added as DistantLights.
        strength: of every light's intensity.
    """
    axes = f"World axes are {AXES}: upAxis is Z, and the dome is turned by 90 degrees about X to match."
    stage = STAGE.format(
        header="\n".join(header(light, lamps, axes, "inputs:exposure of all lights")),
        picture=PICTURE,
        strength=number(strength),
        lamps="".join(_distant(i, lamp, strength) for i, lamp in enumerate(lamps, start=1)),
    )
    return Handover({PICTURE: latlong_picture(nonnegative(light), "usd")}, {TEXT: stage}, f"sublayer or open {TEXT}")


def _distant(place: int, lamp: Lamp, strength: float) -> str:
    x, y, z = frame(lamp.direction)
    return DISTANT.format(
        place=place,
        diameter=number(diameter_degrees(lamp)),
        colour=numbers(lamp.colour),
        intensity=number(strength * max(lamp.irradiance)),
        x=numbers(x),
        y=numbers(y),
        z=numbers(z),
    )


def frame(direction: Vector) -> tuple[Vector, Vector, Vector]:
    """Returns right-handed unit axes x, y, z with z along a direction: the rows of USD's matrix."""
    z = direction
    helper = (0.0, 1.0, 0.0) if abs(z[2]) > 0.9 else (0.0, 0.0, 1.0)
    x = _unit(_cross(helper, z))
    return x, _cross(z, x), z


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(vector: Vector) -> Vector:
    length = sum(value**2 for value in vector) ** 0.5
    return vector[0] / length, vector[1] / length, vector[2] / length
