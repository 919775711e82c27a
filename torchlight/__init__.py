"""torchlight recovers light from shadows: photographs of a known object on a plane in, an HDR environment map out.

    import torchlight as tl

    scene = tl.load_scene("scene.yaml")
    photo = tl.linearize(tl.read_photo("photo.png"), scene)
    estimate = tl.estimate(photo, scene)
    tl.write_light("light.exr", estimate.light, {})

Read `torchlight.pipeline` first: it is the whole story.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchlight import batch as batch
    from torchlight.camera import Camera as Camera
    from torchlight.evenness import evened as evened
    from torchlight.geometry.receiver import Receiver as Receiver
    from torchlight.geometry.scene import Scene as Scene
    from torchlight.insertion.relit import relight_photo as relight_photo
    from torchlight.insertion.relit import remove_shadow as remove_shadow
    from torchlight.insertion.rendering import Insertion as Insertion
    from torchlight.insertion.rendering import insert as insert
    from torchlight.insertion.shading import Material as Material
    from torchlight.inversion.adaptive import AdaptiveHaar as AdaptiveHaar
    from torchlight.inversion.gain import ProjectedGain as ProjectedGain
    from torchlight.inversion.level_by_level import LevelByLevel as LevelByLevel
    from torchlight.inversion.linear import solve as solve
    from torchlight.io.images import read_photo as read_photo
    from torchlight.io.lights import read_light as read_light
    from torchlight.io.lights import write_light as write_light
    from torchlight.io.scene_file import load_scene as load_scene
    from torchlight.light.bases import HaarCubemap as HaarCubemap
    from torchlight.light.bases import SphericalHarmonics as SphericalHarmonics
    from torchlight.light.bases import Texels as Texels
    from torchlight.light.environment import EnvironmentMap as EnvironmentMap
    from torchlight.observing import linearize as linearize
    from torchlight.observing import observe as observe
    from torchlight.photo.observation import LinearPhoto as LinearPhoto
    from torchlight.photo.observation import Observation as Observation
    from torchlight.pipeline import Estimate as Estimate
    from torchlight.pipeline import estimate as estimate
    from torchlight.precomputation import columns_for as columns_for
    from torchlight.precomputation import precompute as precompute
    from torchlight.relighting import irradiance as irradiance
    from torchlight.relighting import relight as relight
    from torchlight.relighting import relight_by as relight_by
    from torchlight.solvers import NNLS as NNLS
    from torchlight.solvers import NonnegativeSynthesis as NonnegativeSynthesis
    from torchlight.solvers import ProjectedAdam as ProjectedAdam
    from torchlight.solvers import Ridge as Ridge
    from torchlight.streaming import stream as stream
    from torchlight.transfer import Transfer as Transfer

# name -> module: imported at first use, because importing torch takes a second that `--help` need not spend
_HOME = {
    "AdaptiveHaar": "inversion.adaptive",
    "Camera": "camera",
    "EnvironmentMap": "light.environment",
    "Estimate": "pipeline",
    "HaarCubemap": "light.bases",
    "Insertion": "insertion.rendering",
    "LevelByLevel": "inversion.level_by_level",
    "LinearPhoto": "photo.observation",
    "Material": "insertion.shading",
    "NNLS": "solvers",
    "NonnegativeSynthesis": "solvers",
    "Observation": "photo.observation",
    "ProjectedAdam": "solvers",
    "ProjectedGain": "inversion.gain",
    "Receiver": "geometry.receiver",
    "Ridge": "solvers",
    "Scene": "geometry.scene",
    "SphericalHarmonics": "light.bases",
    "Texels": "light.bases",
    "Transfer": "transfer",
    "columns_for": "precomputation",
    "estimate": "pipeline",
    "evened": "evenness",
    "insert": "insertion.rendering",
    "irradiance": "relighting",
    "linearize": "observing",
    "load_scene": "io.scene_file",
    "observe": "observing",
    "precompute": "precomputation",
    "read_light": "io.lights",
    "read_photo": "io.images",
    "relight": "relighting",
    "relight_by": "relighting",
    "relight_photo": "insertion.relit",
    "remove_shadow": "insertion.relit",
    "solve": "inversion.linear",
    "stream": "streaming",
    "write_light": "io.lights",
}

__all__ = [
    "NNLS",
    "AdaptiveHaar",
    "Camera",
    "EnvironmentMap",
    "Estimate",
    "HaarCubemap",
    "Insertion",
    "LevelByLevel",
    "LinearPhoto",
    "Material",
    "NonnegativeSynthesis",
    "Observation",
    "ProjectedAdam",
    "ProjectedGain",
    "Receiver",
    "Ridge",
    "Scene",
    "SphericalHarmonics",
    "Texels",
    "Transfer",
    "columns_for",
    "estimate",
    "evened",
    "insert",
    "irradiance",
    "linearize",
    "load_scene",
    "observe",
    "precompute",
    "read_light",
    "read_photo",
    "relight",
    "relight_by",
    "relight_photo",
    "remove_shadow",
    "solve",
    "stream",
    "write_light",
]


def __getattr__(name: str) -> Any:
    if name == "batch":
        return import_module("torchlight.batch")
    if name not in _HOME:
        raise AttributeError(f"module 'torchlight' has no attribute '{name}'")
    value = getattr(import_module(f"torchlight.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, "batch"})
