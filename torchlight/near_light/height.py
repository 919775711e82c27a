"""The height of the light as one photograph tells it, as a place for the light of its scene."""

from __future__ import annotations

from dataclasses import replace

from torchlight.geometry.scene import Scene
from torchlight.light_plane import CLEARANCE, LightPlane
from torchlight.near_light.verdict import NearLight


def lit_as_found(scene: Scene, near: NearLight | None) -> Scene:
    """Returns the scene with its light at the height that the near-light test finds; as it is where that is not told.

    Not told: the light is not flagged as near, or the height is not clear of the occluders.

    Args:
        scene: of the photograph.
        near: what the photograph tells.
    """
    if near is None or not near.flagged or near.height < CLEARANCE * float(scene.triangles[..., 2].max()):
        return scene
    return replace(scene, light_plane=LightPlane(near.height, scene.receiver.center))


def height_deviation(near: NearLight) -> float:
    """Returns the standard deviation of the height: as large a share of it as the drift's, both being set by 1 / h."""
    return near.height * near.deviation_degrees / near.drift_degrees


def height_sentence(scene: Scene, near: NearLight | None) -> str:
    """Returns where the light is taken to stand, in one line.

    Args:
        scene: from `lit_as_found`.
        near: what the photograph tells.
    """
    if near is None:
        return "the light is taken as far away: the photograph does not tell its height"
    if scene.light_plane is None:
        why = "its height is not clear of the object" if near.flagged else "it is not found near"
        return f"the light is taken as far away: {why} (p = {near.p_value:.2g})"
    spread = height_deviation(near)
    return f"the light is taken as standing at {near.height:.3g} +- {spread:.2g} {scene.units}, as its shadow tells"
