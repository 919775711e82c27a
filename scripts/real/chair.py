"""A wall behind a chair lit by a computer screen: light too near for a distant model, read from a MATLAB workspace.

Saunders, Murray-Bruce and Goyal, "Computational periscopy with an ordinary digital camera", Nature 565 (2019). The
screen hangs parallel to the wall at 1030 mm, so that `torchlight.light_plane` gives its shadows exactly; the fall-off
of brightness over the wall, and that the screen is dimmer when seen from the side, are left to `smooth`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.io import loadmat
from scipy.io.matlab import MatReadError, MatReadWarning
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.scene_file import load_scene
from torchlight.light_plane import LightPlane
from torchlight.observing import observe
from torchlight.photo import reference
from torchlight.photo.observation import Observation, linear_photo
from torchlight.pipeline import Estimate, explain
from torchlight.precomputation import columns_for

SCENE = Path(__file__).resolve().parents[2] / "configs" / "scenes" / "periscopy_chair" / "chair.yaml"
SCREEN = 1030.0  # mm from the wall


@dataclass(frozen=True, eq=False)
class Chair:
    """The wall, and what light explains it.

    Attributes:
        scene: chair and wall.
        radiance: the wall's picture, linear; row 0 is the top.
        screen: what the screen showed.
        shown: the wall's samples, the fall-off divided out.
        found: the light.
    """

    scene: Scene
    radiance: Float[Tensor, "3 rows columns"]
    screen: UInt8[np.ndarray, "blocks_high blocks_wide 3"]
    shown: Observation
    found: Estimate


def read_chair(path: Path) -> tuple[Float[Tensor, "3 rows columns"], UInt8[np.ndarray, "high wide 3"]]:
    """Returns the wall's linear picture and what the screen showed.

    Raises:
        FormatError: no such file, or not the workspace of that experiment.
    """
    names = ["test_image1", "ground_truth1"]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MatReadWarning)  # two nameless objects of the workspace, of no use here
            held = loadmat(path, variable_names=names)
        wall, screen = held[names[0]], held[names[1]]
    except (OSError, ValueError, KeyError, MatReadError) as error:
        raise FormatError(f"{path}: expected a MATLAB workspace with {' and '.join(names)}") from error
    return torch.from_numpy(wall).permute(2, 0, 1).float(), screen


def chair(data: Path, lamps: float | None = None) -> Chair:
    """Returns the light that explains the wall by the default method, distant or on a plane at a height."""
    scene = load_scene(SCENE)
    radiance, screen = read_chair(data / "photos" / "periscopy_chair" / "chair_test.mat")
    seen = observe(linear_photo(radiance / radiance.max()), scene)
    shown = reference.divide(seen, reference.smooth(seen, sample_centers(scene.receiver)))
    lit = scene if lamps is None else replace(scene, light_plane=LightPlane(lamps))
    solver = AdaptiveHaar()
    found = explain(shown, lit, columns_for(lit, solver.basis, solver), solver.basis, solver)
    return Chair(scene, radiance / radiance.max(), screen, shown, found)
