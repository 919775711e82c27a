"""Embree through embreex: whether it is here, and a triangle soup as its scene. Without it a torch twin answers.

Embree works in float32: triangles are moved and scaled to the unit box first (`visibility.UnitFrame`).
"""

from __future__ import annotations

import warnings

import numpy as np

from torchlight.errors import ConfigError, TorchlightWarning

try:
    from embreex import mesh_construction, rtcore_scene
except ImportError:  # no wheel for this platform: the torch twin is the stated fallback
    mesh_construction = rtcore_scene = None

OCCLUDED = 0
FAR = 1e37  # its own default for rays without an end


def backend() -> str:
    """Returns the name of the ray caster in use: "embree", or "raycast" where Embree has no wheel."""
    return "raycast" if rtcore_scene is None else "embree"


def is_here_or_warns() -> bool:
    """Returns whether Embree is installed; warns that rays will be slow where it is not."""
    if backend() == "embree":
        return True
    message = "Embree is not installed (no embreex wheel for this platform): the slow torch ray caster is used"
    warnings.warn(message, TorchlightWarning, stacklevel=3)
    return False


def embree_scene(corners: np.ndarray, twin: str):
    """Returns Embree's scene of triangles [faces, 3, 3] in the unit frame; safe to ask from several threads.

    Raises:
        ConfigError: Embree is not installed; names the twin to use.
    """
    if rtcore_scene is None or mesh_construction is None:
        raise ConfigError(f"Embree is not installed: no embreex wheel exists for this platform; use `{twin}`")
    scene = rtcore_scene.EmbreeScene()
    mesh_construction.TriangleMesh(scene, np.ascontiguousarray(corners, dtype=np.float32))
    return scene
