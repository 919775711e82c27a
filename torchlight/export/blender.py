"""For Blender 4.2 or later: an environment texture and sun lamps, set up by a script.

Blender's lat-long is torchlight's: Z up, centre +X. A sun's strength is the irradiance on a plane that faces it.
"""

from __future__ import annotations

from collections.abc import Sequence

from torchlight.export.handover import (
    AXES,
    Handover,
    header,
    lamp_tuples,
    latlong_picture,
    nonnegative,
    number,
)
from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp

PICTURE, TEXT = "light_blender.exr", "light_blender.py"
SCRIPT = '''"""Lights the open scene.

    blender scene.blend --python {text}

{header}
"""

from math import radians
from pathlib import Path

import bpy
from mathutils import Quaternion, Vector

PICTURE = Path(__file__).resolve().with_name("{picture}")
STRENGTH = {strength}  # multiplies picture and lamps
TURN_DEGREES = 0.0  # turns all light about Z, counter-clockwise seen from above
# direction towards the lamp; irradiance on a plane that faces it, red, green, blue; diameter in degrees
LAMPS = {lamps}


def add_environment(scene):
    """Makes a new world of the scene's environment picture."""
    world = bpy.data.worlds.new("torchlight")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    direction = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")
    mapping.vector_type = "TEXTURE"
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, radians(TURN_DEGREES))
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.projection = "EQUIRECTANGULAR"
    texture.image = bpy.data.images.load(str(PICTURE), check_existing=True)
    texture.image.colorspace_settings.name = "Linear Rec.709"
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = STRENGTH
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(direction.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world


def add_lamps(scene):
    """Adds a sun for every lamp."""
    for number, (direction, irradiance, diameter) in enumerate(LAMPS, start=1):
        sun = bpy.data.lights.new(f"torchlight lamp {{number}}", "SUN")
        sun.energy = STRENGTH * max(irradiance)
        sun.color = [value / max(irradiance) for value in irradiance]
        sun.angle = radians(diameter)
        placed = bpy.data.objects.new(sun.name, sun)
        placed.rotation_mode = "QUATERNION"
        towards = Vector(direction).to_track_quat("Z", "Y")  # a sun shines along its own -Z
        placed.rotation_quaternion = Quaternion((0.0, 0.0, 1.0), radians(TURN_DEGREES)) @ towards
        scene.collection.objects.link(placed)


add_environment(bpy.context.scene)
add_lamps(bpy.context.scene)
'''


def blender(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture and the script for Blender.

    Args:
        light: without the lamps.
        lamps: to be added as suns.
        strength: written into the script.
    """
    about = header(light, lamps, f"World axes are {AXES}, which Blender shares.", "STRENGTH")
    text = SCRIPT.format(
        text=TEXT,
        picture=PICTURE,
        header="\n".join(about),
        strength=number(strength),
        lamps=lamp_tuples(lamps),
    )
    picture = latlong_picture(nonnegative(light), "blender")
    return Handover({PICTURE: picture}, {TEXT: text}, f"blender scene.blend --python {TEXT}")
