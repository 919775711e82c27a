"""A photograph under another light, or without the shadow on its plane: pixels times a ratio of irradiances.

    relit     = P E_new / E_old             on the plane, and on the objects that are there, taken as diffuse
    unshadowed = P E_open / E_old           on the plane; the objects' own pixels are a hole

Where E_old is small the photograph holds little but noise: the ratio is held at a bound, and such pixels are counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.geometry.scene import Scene
from torchlight.insertion.cells import CELLS, light_cells
from torchlight.insertion.looking import OLD, PLANE, look
from torchlight.insertion.plane import Lamp, behind, receive_behind
from torchlight.insertion.refining import COARSEST, Computed, Picture, Progress, Steps, refined
from torchlight.insertion.rendering import top_of
from torchlight.insertion.sight import Sight, sight_of
from torchlight.insertion.stage import Stage, stage_of
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.relighting import lit_by

MOST_GAIN = 8.0  # three stops: beyond it, 1 % of noise is a tenth of the picture


@dataclass(frozen=True)
class Bounds:
    """How a photograph is relit.

    Attributes:
        rays: directions that each light is cut into.
        gain: a pixel is brightened at most so many times, relative to the lights' open plane.
    """

    rays: int = CELLS
    gain: float = MOST_GAIN

    def __post_init__(self) -> None:
        if not 1.0 <= self.gain < float("inf"):
            raise ConfigError(f"gain: expected a bound of at least 1, got {self.gain:g}; {MOST_GAIN:g} is usual")


@dataclass(frozen=True, eq=False)
class Relit:
    """A photograph multiplied by a ratio of irradiances.

    Attributes:
        picture: linear.
        hole: pixels that show an object wholly or in part, where that was to be removed; else none.
        held: pixels whose ratio was held at the bound.
        unknown: pixels that show neither the plane nor an object: left as they were.
    """

    picture: Float[Tensor, "3 height width"]
    hole: Bool[Tensor, "height width"]
    held: Bool[Tensor, "height width"]
    unknown: Bool[Tensor, "height width"]


def relight_photo(
    photo: LinearPhoto | Float[Tensor, "3 height width"],
    scene: Scene,
    old: EnvironmentMap,
    new: EnvironmentMap,
    bounds: Bounds | None = None,
    progress: Progress | None = None,
) -> Relit:
    """Returns the photograph as it would be under another light: P E_new / E_old.

    Args:
        photo: linear; rectified where the scene has no camera.
        scene: what stands there, the receiver, the camera.
        old: the light of the photograph, such as the one recovered from it.
        new: the other, in the same units.
        bounds: None = `Bounds()`.
        progress: called with (cells done, cells).

    Raises:
        SceneError: a light stands elsewhere than the scene says.
        CalibrationError: the photograph's size is not the camera's.
    """
    bounds = Bounds() if bounds is None else bounds
    linear = photo if isinstance(photo, LinearPhoto) else linear_photo(photo)
    shown = [received(linear, scene, light, bounds, progress) for light in (old, new)]
    before, after = (picture.values[:3] for picture in shown)
    level = after.mean() / before.mean().clamp(min=1e-30)
    gain, held = bounded(before, after, bounds.gain * level)
    known = shown[0].kind > 0
    return Relit(lit(linear, gain, known), torch.zeros_like(known), held & known, ~known)


def remove_shadow(
    photo: LinearPhoto | Float[Tensor, "3 height width"],
    scene: Scene,
    light: EnvironmentMap,
    bounds: Bounds | None = None,
    progress: Progress | None = None,
) -> Relit:
    """Returns the photograph with the plane as it would be without the objects on it: P E_open / E_old.

    The pixels that show an object, wholly or in part, are the hole: `filled` continues the plane over them.

    Args:
        photo: linear; rectified where the scene has no camera.
        scene: what stands there, the receiver, the camera.
        light: of the photograph.
        bounds: None = `Bounds()`.
        progress: called with (cells done, cells).

    Raises:
        SceneError: the light stands elsewhere than the scene says.
        CalibrationError: the photograph's size is not the camera's.
    """
    bounds = Bounds() if bounds is None else bounds
    linear = photo if isinstance(photo, LinearPhoto) else linear_photo(photo)
    shown = received(linear, scene, light, bounds, progress)
    without, unshadowed, partly = shown.values.split((3, 3, 1))
    gain, held = bounded(without, unshadowed, torch.tensor(bounds.gain, dtype=torch.float64))
    hole = (shown.kind == OLD) | (partly[0] > 0)
    plane = (shown.kind == PLANE) & ~hole
    return Relit(lit(linear, gain, plane), hole, held & plane, ~plane & ~hole)


def received(
    photo: LinearPhoto, scene: Scene, light: EnvironmentMap, bounds: Bounds, progress: Progress | None
) -> Picture:
    """Returns, of what every pixel shows, the irradiance, that without any object, and the objects' share of it."""
    scene = lit_by(scene, light)
    nothing = scene.triangles.double()[:0]
    size = (photo.radiance.shape[-1], photo.radiance.shape[-2])
    sight = sight_of(scene, size, top_of(scene, nothing))
    stage, lamp = stage_of(scene, nothing), Lamp(light_cells(light, bounds.rays), light.plane)
    level = lamp.cells.powers.double() * lamp.cells.directions.double()[:, 2:]
    return _scaled(refined(sight, _task(stage, lamp, level.sum(dim=0)), 7, Steps(progress, 2 * COARSEST)), level.sum(0))


def _task(stage: Stage, lamp: Lamp, level: Float[Tensor, "3"]):
    """Returns what `refined` asks: irradiances as shares of the open plane's."""
    scale = torch.where(level > 0, level, 1.0)

    def task(view: Sight, index: Tensor) -> Computed:
        seen = look(stage, view, index)
        kind = behind(seen)
        found = receive_behind(seen, kind, stage, lamp)
        objects = (seen.kind == OLD).double().mean(dim=1, keepdim=True)
        return torch.cat([found.without / scale, found.open / scale, objects], dim=1), kind

    return task


def _scaled(picture: Picture, level: Float[Tensor, "3"]) -> Picture:
    """Returns the shares of the open plane's irradiance as irradiances."""
    factor = torch.cat([level, level, torch.ones(1, dtype=level.dtype)])
    return Picture(picture.values * torch.where(factor > 0, factor, 1.0)[:, None, None], picture.kind)


def bounded(
    before: Float[Tensor, "3 height width"], after: Float[Tensor, "3 height width"], most: Float[Tensor, ""]
) -> tuple[Float[Tensor, "3 height width"], Bool[Tensor, "height width"]]:
    """Returns after / before, at most so much, and where it was held."""
    beyond = after > most * before
    gain = torch.where(beyond, most, after / torch.where(beyond | (before <= 0), 1.0, before))
    return gain.clamp(min=0), beyond.any(dim=0)


def lit(
    photo: LinearPhoto, gain: Float[Tensor, "3 height width"], where: Bool[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """Returns the photograph times the gain where it is known."""
    return torch.where(where, photo.radiance * gain.to(photo.radiance), photo.radiance)


def filled(
    picture: Float[Tensor, "3 height width"], hole: Bool[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """Returns the picture with a hole filled smoothly from around it: means of ever larger squares, coarse to fine."""
    known = (~hole).to(picture)[None]
    if bool(hole.all()) or not bool(hole.any()):
        return picture
    layers = torch.cat([torch.where(hole, torch.zeros_like(picture), picture), known])
    smooth = _pulled(layers)
    return torch.where(hole, smooth, picture)


def _pulled(layers: Float[Tensor, "4 height width"]) -> Float[Tensor, "3 height width"]:
    """Returns values everywhere from values times weights, and weights."""
    values, weights = layers[:3], layers[3:]
    own = values / weights.clamp(min=1e-12)
    if bool((weights > 0).all()):
        return own
    size = values.shape[-2:]
    coarse = torch.nn.functional.avg_pool2d(layers[None], 2, ceil_mode=True, count_include_pad=False)[0]
    under = torch.nn.functional.interpolate(_pulled(coarse)[None], size=size, mode="bilinear", align_corners=False)[0]
    return torch.where(weights > 0, own, under)
