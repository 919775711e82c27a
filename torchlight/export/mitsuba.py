"""For Mitsuba 3: a finer environment map, and emitters as a Python dictionary and as XML.

Mitsuba interpolates between picture points at theta = pi r / (H - 1) and at azimuths of column centres, where
torchlight's maps are constant over each pixel. It is handed a map of 2 H + 1 rows and 4 H columns: every pixel twice in
both directions, rows on pixel edges the mean of both sides. Interpolating it gives the constant pixels back, but for a
ramp of half a pixel across every edge, which is symmetric and keeps the integral.

Lamps are discs far away, since Mitsuba's directional emitter has no size: radiance L over an angle a about the lamp
brings pi L sin^2 a to a plane that faces it. A disc hides the map behind it, so it shines with that as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.export.handover import (
    AXES,
    Handover,
    Picture,
    diameter_degrees,
    header,
    nonnegative,
    number,
    numbers,
)
from torchlight.light.environment import EnvironmentMap
from torchlight.light.formats import to_latlong
from torchlight.light.lamps import Lamp, disc_mean

PICTURE, TEXT, XML = "light_mitsuba.exr", "light_mitsuba.py", "light_mitsuba.xml"
DISTANCE = 1000.0
AXES_HERE = f"World axes are {AXES}; the map, stored with Y up, is turned by 90 degrees about X."
SCRIPT = '''"""Emitters for Mitsuba 3.5 or later.

    import mitsuba as mi
    mi.set_variant("scalar_rgb")
    from {module} import emitters
    scene = mi.load_dict({{"type": "scene", **emitters(), ...}})

{header}
"""

from math import radians, tan, sin, pi
from pathlib import Path

import mitsuba as mi

PICTURE = Path(__file__).resolve().with_name("{picture}")
STRENGTH = {strength}  # multiplies picture and lamps
# direction towards the lamp; irradiance on a plane that faces it, red, green, blue; diameter in degrees;
# radiance of the picture behind it, which the disc hides and therefore adds
LAMPS = {lamps}


def environment():
    """Returns the environment map."""
    turned = mi.ScalarTransform4f().rotate([1.0, 0.0, 0.0], 90.0)
    return {{"type": "envmap", "filename": str(PICTURE), "scale": STRENGTH, "to_world": turned}}


def lamp(direction, irradiance, diameter, behind, distance):
    """Returns a disc that shines on the origin from a distance."""
    angle = radians(diameter / 2)
    radiance = [STRENGTH * (e / (pi * sin(angle) ** 2) + b) for e, b in zip(irradiance, behind)]
    up = [0.0, 1.0, 0.0] if abs(direction[2]) > 0.9 else [0.0, 0.0, 1.0]
    place = mi.ScalarTransform4f().look_at([distance * value for value in direction], [0.0, 0.0, 0.0], up)
    size = distance * tan(angle)
    return {{
        "type": "disk",
        "to_world": place.scale([size, size, 1.0]),
        "emitter": {{"type": "area", "radiance": {{"type": "rgb", "value": radiance}}}},
    }}


def emitters(distance={distance}):
    """Returns everything that shines; lamps stand at a distance that is large against the scene."""
    lamps = {{f"lamp_{{i}}": lamp(*values, distance) for i, values in enumerate(LAMPS, start=1)}}
    return {{"environment": environment(), **lamps}}
'''
ENVIRONMENT_XML = """    <emitter type="envmap" id="environment">
        <string name="filename" value="{picture}"/>
        <float name="scale" value="{strength}"/>
        <transform name="to_world"><rotate x="1" angle="90"/></transform>
    </emitter>
"""
LAMP_XML = """    <shape type="disk" id="lamp_{number}">
        <transform name="to_world">
            <scale x="{size}" y="{size}"/>
            <lookat origin="{origin}" target="0, 0, 0" up="{up}"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter>
    </shape>
"""


def mitsuba(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture, the Python module and the XML for Mitsuba.

    Args:
        light: without the lamps.
        lamps: to be added as distant discs.
        strength: written into the texts.
    """
    about = header(light, lamps, AXES_HERE, "STRENGTH")
    text = SCRIPT.format(
        module=TEXT.removesuffix(".py"),
        picture=PICTURE,
        header="\n".join(about),
        strength=number(strength),
        lamps=_tuples(light, lamps),
        distance=number(DISTANCE),
    )
    shown = nonnegative(light)
    metadata = {"rows": "theta = pi r / (H - 1)", "centre": "+Z, Y up", "units": light.units}
    picture = Picture(interpolated(shown).float(), metadata)
    return Handover(
        {PICTURE: picture}, {TEXT: text, XML: xml(light, lamps, strength)}, f"from {TEXT[:-3]} import emitters"
    )


def interpolated(light: EnvironmentMap) -> Float[Tensor, "3 rows columns"]:
    """Returns the map of 2 H + 1 rows and 4 H columns that Mitsuba interpolates to the light, constant per pixel."""
    twice = to_latlong(light.radiance, "mitsuba").repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2)
    above = torch.cat([twice[:, :1], twice], dim=-2)
    below = torch.cat([twice, twice[:, -1:]], dim=-2)
    return (above + below) / 2


def xml(light: EnvironmentMap, lamps: Sequence[Lamp], strength: float) -> str:
    """Returns the emitters as a scene file that another includes."""
    about = header(light, lamps, AXES_HERE, "scale and radiance")
    shapes = [_lamp_xml(i, lamp, _behind(light, lamp), strength) for i, lamp in enumerate(lamps, start=1)]
    environment = ENVIRONMENT_XML.format(picture=PICTURE, strength=number(strength))
    note = "\n     ".join(['Include it: <include filename="light_mitsuba.xml"/>', *about])
    return f'<scene version="3.0.0">\n<!-- {note} -->\n{environment}{"".join(shapes)}</scene>\n'


def _behind(light: EnvironmentMap, lamp: Lamp) -> list[float]:
    return disc_mean(lamp, light.radiance.clamp(min=0)).tolist()


def _tuples(light: EnvironmentMap, lamps: Sequence[Lamp]) -> str:
    """Returns (direction, irradiance facing it, diameter in degrees, radiance behind it) of each lamp, as Python."""
    rows = [
        f"    (({numbers(it.direction)}), ({numbers(it.irradiance)}), {diameter_degrees(it):.7g}, "
        f"({numbers(_behind(light, it))})),\n"
        for it in lamps
    ]
    return "(\n" + "".join(rows) + ")" if rows else "()"


def _lamp_xml(place: int, lamp: Lamp, behind: Sequence[float], strength: float) -> str:
    up = "0, 1, 0" if abs(lamp.direction[2]) > 0.9 else "0, 0, 1"
    radiance = [strength * (own + hidden) for own, hidden in zip(lamp.radiance, behind, strict=True)]
    return LAMP_XML.format(
        number=place,
        size=number(DISTANCE * math.tan(lamp.radius)),
        origin=numbers([DISTANCE * value for value in lamp.direction]),
        up=up,
        radiance=numbers(radiance),
    )
