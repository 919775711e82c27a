"""A cube's shadow: its left half gives the light, which then predicts its right half.

The light is judged by samples it has never seen: neither the fall-off nor the light is fitted to anything right of the
shadow's axis. There a sample is in shadow where its predicted brightness lies below the middle between the brightest
and the darkest prediction, and is compared with the outline that was drawn over the photograph beforehand.

The lamp hangs 0.6 m above the desk, so that its shadow widens: distant light, the usual model, throws the right edge
where the left one asks for it, too far left. How high the lamp hangs is told by the left half itself, as
`torchlight estimate --estimate-height` asks it, or measured in another photograph of it (`light.height`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.images import read_photo
from torchlight.io.scene_file import load_scene
from torchlight.light_plane import LightPlane
from torchlight.near_light.verdict import NearLight, near_light
from torchlight.observing import linearize, observe
from torchlight.photo import reference
from torchlight.photo.observation import Observation
from torchlight.pipeline import Estimate, explain
from torchlight.precomputation import columns_for

from .drawing import Drawing, foreign_part, inside, read_drawing, right_of_axis
from .lamp_plane import lamp_height, shadow_width

FOLDER = Path(__file__).resolve().parents[2] / "configs" / "scenes" / "desk_cube10cm"
THRESHOLD = 0.5  # of the way from the darkest to the brightest prediction
SIDE, HEIGHT = 101.0, 104.0  # mm, of the cube as the scenes have it
ROWS, CORE, RIM = (-82.0, -60.0), 40.0, 66.0  # mm: before the cube; surely umbra; lit


@dataclass(frozen=True, eq=False)
class HalfShadow:
    """A light found on one half of a shadow, and what it predicts of the other.

    Attributes:
        scene: the cube, the plane, the camera.
        shown: what the photograph shows of both halves, before any fall-off is divided out.
        estimate: the light, fitted to the left half alone; its prediction covers both.
        right: usable samples right of the axis.
        drawn: those of them within the drawn outline.
    """

    scene: Scene
    shown: Observation
    estimate: Estimate
    right: Bool[Tensor, " points"]
    drawn: Bool[Tensor, " points"]


def half_shadow(photo: Path, scene: Scene, drawing: Drawing, lamps: float | None = None) -> HalfShadow:
    """Returns the light that the default method finds on the left half, and its prediction.

    Args:
        photo: the photograph.
        scene: cube, plane and camera.
        drawing: the axis and the outlines.
        lamps: height of the lamps above the plane; None = distant light.
    """
    centers = sample_centers(scene.receiver)
    right = right_of_axis(drawing, centers)
    shown = shown_of_both(photo, scene, drawing)
    fitted = left_half(shown, scene, drawing)
    lit = scene if lamps is None else replace(scene, light_plane=LightPlane(lamps))
    solver = AdaptiveHaar()
    found = explain(fitted, lit, columns_for(lit, solver.basis, solver), solver.basis, solver)
    usable = right & (shown.weights > 0)
    return HalfShadow(scene, shown, found, usable, usable & inside(drawing.shadow, centers))


def cube(data: Path, lamps: float | None = None) -> HalfShadow:
    """Returns the half shadow of img4 under distant light, or under lamps at a height."""
    drawing = read_drawing(FOLDER / "drawn" / "img4.yaml")
    return half_shadow(photo_of(data, "img4"), load_scene(FOLDER / "img4.yaml"), drawing, lamps)


def shown_of_both(photo: Path, scene: Scene, drawing: Drawing) -> Observation:
    """Returns what the photograph shows of both halves, without what the scene does not know."""
    seen = observe(linearize(read_photo(photo), scene), replace(scene, reference="uniform"))
    return replace(seen, weights=seen.weights * ~foreign_part(drawing, sample_centers(scene.receiver)))


def left_half(shown: Observation, scene: Scene, drawing: Drawing) -> Observation:
    """Returns the left half alone, its own fall-off divided out."""
    centers = sample_centers(scene.receiver)
    left = replace(shown, weights=shown.weights * ~right_of_axis(drawing, centers))
    return reference.divide(left, reference.smooth(left, centers))


def told_by_the_left(data: Path) -> NearLight | None:
    """Returns what the left half of img4 alone tells of the distance of its light."""
    drawing, scene = read_drawing(FOLDER / "drawn" / "img4.yaml"), load_scene(FOLDER / "img4.yaml")
    shown = shown_of_both(photo_of(data, "img4"), scene, drawing)
    return near_light(scene, left_half(shown, scene, drawing))


def measured_lamp_height(data: Path) -> float:
    """Returns the lamp's height above the desk in mm, from the width of the cube's shadow in img3."""
    scene = load_scene(FOLDER / "img3.yaml")
    seen = observe(linearize(read_photo(photo_of(data, "img3")), scene), scene)
    width = shadow_width(seen, sample_centers(scene.receiver), ROWS, CORE, RIM)
    return lamp_height(SIDE, width, HEIGHT)


def photo_of(data: Path, name: str) -> Path:
    """Returns the file of one of the cube's photographs."""
    return data / "photos" / "desk_cube10cm" / f"{name}.JPG"


def in_shadow(
    grey: Float[Tensor, " points"], among: Bool[Tensor, " points"], share: float = THRESHOLD
) -> Bool[Tensor, " points"]:
    """Returns which of the samples are darker than a share of the way from the darkest of them to the brightest."""
    low, high = grey[among].min(), grey[among].max()
    return among & (grey < low + share * (high - low))


def overlap(one: Bool[Tensor, " points"], other: Bool[Tensor, " points"]) -> float:
    """Returns intersection over union."""
    return ((one & other).sum() / (one | other).sum()).item()


def predicted_shadow(half: HalfShadow, share: float = THRESHOLD) -> Bool[Tensor, " points"]:
    """Returns which usable samples right of the axis are predicted to lie in shadow."""
    return in_shadow(half.estimate.predicted.mean(dim=-2), half.right, share)


def predicted_overlap(half: HalfShadow, share: float = THRESHOLD) -> float:
    """Returns intersection over union of the predicted and the drawn shadow, over usable samples right of the axis."""
    return overlap(predicted_shadow(half, share), half.drawn)
