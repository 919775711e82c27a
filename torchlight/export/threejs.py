"""For three.js: an equirectangular picture and directional lights, set up by a module.

three.js has Y up; a scene of torchlight's comes to it by (x, y, z) -> (x, z, -y), and then the picture needs no
change. For a scene that keeps Z up the environment is turned by 90 degrees about X instead. An environment map casts no
shadow in three.js; only the lamps do. They have no size.
"""

from __future__ import annotations

from collections.abc import Sequence

from torchlight.export.handover import (
    AXES,
    Handover,
    commented,
    header,
    latlong_picture,
    nonnegative,
    number,
    numbers,
)
from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp

PICTURE, TEXT = "light_threejs.exr", "light_threejs.js"
HALF_MAXIMUM = 65000.0  # half precision ends at 65504; it is filtered on every device, float32 not on all
MODULE = """// For three.js r163 or later.
//
//   import {{ addLight }} from './{text}';
//   await addLight(scene);
//
{header}
import * as THREE from 'three';
import {{ EXRLoader }} from 'three/addons/loaders/EXRLoader.js';

export const PICTURE = new URL('./{picture}', import.meta.url).href;
export const STRENGTH = {strength}; // multiplies picture and lamps
// towards the lamp, in torchlight's world; irradiance on a plane that faces it, red, green, blue
export const LAMPS = [{lamps}];

// Returns a direction of torchlight's world in a scene with 'Y' or 'Z' up.
export function toScene([x, y, z], up = 'Y') {{
  return up === 'Y' ? new THREE.Vector3(x, z, -y) : new THREE.Vector3(x, y, z);
}}

// Sets background and environment of a scene.
export async function addEnvironment(scene, up = 'Y') {{
  const texture = await new EXRLoader().setDataType(THREE.{precision}).loadAsync(PICTURE);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  scene.background = scene.environment = texture;
  scene.backgroundIntensity = scene.environmentIntensity = STRENGTH;
  const turn = up === 'Y' ? 0 : Math.PI / 2;
  scene.backgroundRotation.set(turn, 0, 0);
  scene.environmentRotation.set(turn, 0, 0);
  return texture;
}}

// Adds the lamps as directional lights that cast shadows of what lies within `reach` of the origin.
export function addLamps(scene, up = 'Y', reach = 5) {{
  return LAMPS.map(({{ direction, irradiance }}) => {{
    const largest = Math.max(...irradiance);
    const colour = new THREE.Color().setRGB(...irradiance.map((value) => value / largest));
    const light = new THREE.DirectionalLight(colour, STRENGTH * largest);
    light.position.copy(toScene(direction, up)).multiplyScalar(2 * reach);
    light.castShadow = true;
    Object.assign(light.shadow.camera, {{ left: -reach, right: reach, top: reach, bottom: -reach, far: 4 * reach }});
    scene.add(light);
    return light;
  }});
}}

export async function addLight(scene, up = 'Y', reach = 5) {{
  addLamps(scene, up, reach);
  return addEnvironment(scene, up);
}}
"""


def threejs(light: EnvironmentMap, lamps: Sequence[Lamp] = (), strength: float = 1.0) -> Handover:
    """Returns the picture and the module for three.js.

    Args:
        light: without the lamps.
        lamps: to be added as directional lights.
        strength: written into the module.
    """
    axes = (
        f"LAMPS are in world axes that are {AXES}. A scene with Y up has (x, z, -y); pass 'Z' for one that keeps them."
    )
    shown = nonnegative(light)
    about = [*header(light, lamps, axes, "STRENGTH"), "The picture casts no shadows in three.js; lamps do."]
    rows = [f"\n  {{ direction: [{numbers(it.direction)}], irradiance: [{numbers(it.irradiance)}] }}," for it in lamps]
    text = MODULE.format(
        text=TEXT,
        header=commented(about, "//").rstrip(),
        picture=PICTURE,
        strength=number(strength),
        lamps="".join(rows) + ("\n" if rows else ""),
        precision="HalfFloatType" if float(shown.radiance.max()) <= HALF_MAXIMUM else "FloatType",
    )
    use = f"import {{ addLight }} from './{TEXT}'"
    return Handover({PICTURE: latlong_picture(shown, "threejs")}, {TEXT: text}, use)
