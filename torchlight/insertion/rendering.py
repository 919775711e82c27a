"""Differential rendering: an object into a photograph, by the light that was recovered from it (Debevec 1998).

stage    = stage_of(scene, object)                  what stands there, old and new
lamp     = light_cells(light)                       directions with powers
coverage, radiance = the new object, pixel by pixel: shaded, lit past the old objects and itself
ratio    = (E without - E lost) / E without         on the plane and on the old objects
layer    = object over shadow; composite = layer over photograph
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchlight.camera import project
from torchlight.errors import ConfigError
from torchlight.geometry.scene import Scene
from torchlight.insertion.cells import CELLS, Cells, light_cells
from torchlight.insertion.compositing import Layer, layer_of, over
from torchlight.insertion.gathering import Ground, throw, throw_bounced
from torchlight.insertion.looking import NEW, OLD, PLANE, Seen, look
from torchlight.insertion.placing import check_above
from torchlight.insertion.plane import Lamp, behind, darkened, receive_behind
from torchlight.insertion.refining import COARSEST, Computed, Picture, Progress, Steps, refined
from torchlight.insertion.shading import Material
from torchlight.insertion.sight import Sight, receiver_pixels, sight_of
from torchlight.insertion.stage import Stage, stage_of
from torchlight.insertion.unmixing import visible_part
from torchlight.interreflection import WHITE_PAPER
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.relighting import albedo_over_pi, lit_by, relight
from torchlight.threads import single_threaded_map

BLOCK = 2048  # cells at once
GROUND_RAYS = 4096
ROOM = 2  # pixels round the object's outline
BRIGHT = 0.2  # of the brightest predicted pixel: what counts when brightness is compared


@dataclass(frozen=True)
class Rendering:
    """How the object is rendered.

    Attributes:
        rays: directions that the light is cut into.
        bounce: whether light that the plane throws back on the object counts: one bounce.
        only_receiver: whether the plane, and so the shadow, ends where the receiver does.
        fit_brightness: whether the light is scaled, per channel, to what the photograph shows of the plane.
    """

    rays: int = CELLS
    bounce: bool = False
    only_receiver: bool = False
    fit_brightness: bool = False


@dataclass(frozen=True, eq=False)
class Insertion:
    """The object in the photograph, in linear light.

    Attributes:
        composite: the photograph with the object and its shadow; equal to it where nothing changed.
        layer: object and shadow, to be put over the photograph.
        coverage: share of each pixel that the object covers.
        ratio: what the shadow leaves of each pixel.
        brightness: photograph / what this light shows of the plane, per channel: 1 for a light recovered from this
            photograph; NaN where the photograph shows no lit plane.
    """

    composite: Float[Tensor, "3 height width"]
    layer: Layer
    coverage: Float[Tensor, "height width"]
    ratio: Float[Tensor, "3 height width"]
    brightness: Float[Tensor, "3"]

    @property
    def changed(self) -> Bool[Tensor, "height width"]:
        """Pixels that the insertion may have changed."""
        return self.layer.alpha > 0


def insert(
    photo: LinearPhoto | Float[Tensor, "3 height width"],
    scene: Scene,
    light: EnvironmentMap,
    triangles: Float[Tensor, "faces 3 3"],
    material: Material | None = None,
    rendering: Rendering | None = None,
    progress: Progress | None = None,
) -> Insertion:
    """Returns the photograph with an object in it: shaded, self-shadowed, hidden where objects are in front.

    Its shadow falls on the plane and on the objects that are there (taken as diffuse), as the ratio of the irradiance
    with it to that without it. Where the scene states no albedo of the plane, the light is radiance x albedo of the
    plane, and the material counts relative to the plane: albedo 1 is as bright as the plane.

    Args:
        photo: linear; rectified where the scene has no camera.
        scene: what stands there, the receiver, the camera.
        light: recovered from this photograph, or another in the same units.
        triangles: of the object, in the world (`torchlight.insertion.placing.stood`).
        material: None = `Material()`, diffuse and grey.
        rendering: None = `Rendering()`.
        progress: called with (cells done, cells).

    Raises:
        SceneError: the object has no faces or lies below the plane, or the scene's light stands elsewhere.
        CalibrationError: the photograph's size is not the camera's.
        ConfigError: a number of rays, or an albedo above 1 where the plane's is known.
    """
    material = Material() if material is None else material
    rendering = Rendering() if rendering is None else rendering
    linear = photo if isinstance(photo, LinearPhoto) else linear_photo(photo)
    check_above(triangles)
    check_albedo(material, scene)
    scene = lit_by(scene, light)
    sight = sight_of(scene, (linear.radiance.shape[-1], linear.radiance.shape[-2]), top_of(scene, triangles))
    stage = stage_of(scene, triangles)
    lamp = Lamp(light_cells(light, rendering.rays), light.plane)
    ground = ground_of(scene, light, triangles) if rendering.bounce else None
    index = around(sight, triangles)
    steps = Steps(progress, len(index) + 2 * COARSEST)
    thing = object_layer(stage, sight, index, lamp, material, ground, steps)
    shadow = shadow_layer(stage, sight, lamp, rendering.only_receiver, steps)
    darker, shown = shadow.values.split(3)
    factor = albedo_over_pi(scene.receiver, shown)[:, :, None]
    predicted = torch.where(shadow.kind == PLANE, shown * factor, 0.0)
    brightness = brightness_of(linear, predicted, receiver_pixels(sight))
    gain = brightness if rendering.fit_brightness else torch.ones_like(brightness)
    pixels = linear.radiance
    ratio = (1 - darker) * visible_part(pixels, thing.before, thing.after)
    shaded = thing.radiance * gain.nan_to_num(nan=1.0)[:, None, None]
    layer = layer_of(pixels, *(part.to(pixels) for part in (shaded, thing.coverage, ratio)))
    return Insertion(over(layer, pixels), layer, thing.coverage, 1 - darker, brightness)


@dataclass(frozen=True, eq=False)
class Thing:
    """The new object as it is seen.

    Attributes:
        coverage: share of each pixel that it covers.
        radiance: of what is seen of it.
        before: share of the old objects in each pixel without it; NaN where nobody asked.
        after: their share in what it leaves visible; likewise, and where it leaves nothing.
    """

    coverage: Float[Tensor, "height width"]
    radiance: Float[Tensor, "3 height width"]
    before: Float[Tensor, "height width"]
    after: Float[Tensor, "height width"]


def object_layer(
    stage: Stage,
    sight: Sight,
    index: Int[Tensor, " cells"],
    lamp: Lamp,
    material: Material,
    ground: Ground | None,
    steps: Steps,
) -> Thing:
    """Returns the new object as the pixels with these numbers show it."""
    cells = lamp.seen_from(stage.middle[1])

    def rendered(part: Tensor) -> Float[Tensor, "cells 6"]:
        seen = look(stage, sight, part)
        here = seen.kind == NEW
        rows = here.any(dim=1)
        radiance = torch.zeros(len(part), 3, dtype=torch.float64)
        if bool(rows.any()):
            radiance[rows] = shaded(seen.only(rows, NEW), cells, stage, material, ground)
        before = old_share(before_of(stage, sight, part))
        return torch.cat(
            [here.double().mean(dim=1)[:, None], radiance, before[:, None], old_share(seen.kind)[:, None]], 1
        )

    columns, rows = sight.grid
    values = torch.zeros(6, sight.cells, dtype=torch.float64)
    values[4:] = torch.nan
    parts = index.split(BLOCK)
    for part, found in zip(parts, single_threaded_map(rendered, parts), strict=True):
        values[:, part] = found.T
        steps.add(len(part))
    picture = values.reshape(6, rows, columns)
    return Thing(picture[0], picture[1:4], picture[4], picture[5])


def shaded(
    seen: Seen, cells: Cells, stage: Stage, material: Material, ground: Ground | None
) -> Float[Tensor, "points 3"]:
    """Returns the radiance of points of the new object."""
    thrown = [throw(seen, cells, stage.over_objects, material)]
    if ground is not None:
        thrown.append(throw_bounced(seen, ground, stage.over_objects, material))
    irradiance, lobe = (torch.stack([getattr(t, name) for t in thrown]).sum(dim=0) for name in ("irradiance", "lobe"))
    albedo = torch.tensor(material.albedo, dtype=torch.float64) / torch.pi
    return (1 - material.gloss) * albedo * irradiance + material.gloss * lobe


def before_of(stage: Stage, sight: Sight, index: Int[Tensor, " cells"]) -> UInt8[Tensor, "cells sub"]:
    """Returns what the rays of cells show without the new object."""
    return look(replace(stage, eye=stage.eye_before), sight, index).kind


def old_share(kind: UInt8[Tensor, "cells sub"]) -> Float[Tensor, " cells"]:
    """Returns the share of old objects in what each cell shows of them and the plane; NaN where it shows neither."""
    old, plane = ((kind == which).double().sum(dim=1) for which in (OLD, PLANE))
    return old / torch.where(old + plane > 0, old + plane, torch.nan)


def shadow_layer(stage: Stage, sight: Sight, lamp: Lamp, only_receiver: bool, steps: Steps) -> Picture:
    """Returns 1 - r and the irradiance without the object, of what each pixel shows behind it."""

    def gathered(view: Sight, index: Tensor) -> Computed:
        seen = look(stage, view, index, only_receiver)
        kind = behind(seen)
        received = receive_behind(seen, kind, stage, lamp)
        return torch.cat([darkened(received), received.without], dim=1), kind

    return refined(sight, gathered, 3, steps)


def around(sight: Sight, triangles: Float[Tensor, "faces 3 3"]) -> Int[Tensor, " pixels"]:
    """Returns the pixels of the rectangle that holds the object's outline; all where it reaches behind the camera."""
    corners = triangles.reshape(-1, 3).double()
    width, height = sight.size
    if sight.camera is None:
        size, center = (torch.tensor(v, dtype=torch.float64) for v in (sight.receiver.size, sight.receiver.center))
        share = (corners[:, :2] - center) / size * torch.tensor([1.0, -1.0]).double() + 0.5
        pixels = share * torch.tensor([width, height]) - 0.5
    else:
        pixels = project(sight.camera, corners)
    if not bool(pixels.isfinite().all()):
        return torch.arange(width * height)
    room = ROOM + 0.02 * (pixels.amax(dim=0) - pixels.amin(dim=0))
    left, upper = (pixels.amin(dim=0) - room).floor().long().clamp(min=0).tolist()
    right, lower = (pixels.amax(dim=0) + room).ceil().long().tolist()
    rows = torch.arange(upper, max(upper, min(lower + 1, height)))
    columns = torch.arange(left, max(left, min(right + 1, width)))
    return (rows[:, None] * width + columns).flatten()


def brightness_of(
    photo: LinearPhoto, predicted: Float[Tensor, "3 height width"], known: Bool[Tensor, "height width"]
) -> Float[Tensor, "3"]:
    """Returns the median of photograph / prediction over the lit plane, per channel; NaN where there is none.

    Args:
        photo: linear.
        predicted: what the plane shows by the light; 0 where no plane is seen.
        known: pixels of the receiver: beyond it a desk may end.
    """
    shown = predicted.amax(dim=0)
    lit = photo.usable & known & (shown > BRIGHT * shown.max())
    if not bool(lit.any()):
        return torch.full((3,), torch.nan, dtype=torch.float64)
    light = predicted[:, lit]
    return (photo.radiance[:, lit].double() / light.clamp(min=1e-30)).median(dim=1).values


def ground_of(scene: Scene, light: EnvironmentMap, triangles: Float[Tensor, "faces 3 3"]) -> Ground:
    """Returns the plane's own radiance with both objects on it, in the units in which the light is stated.

    Where the plane's albedo is not known, what it throws back is the share `WHITE_PAPER` of what is shown.
    """
    both = replace(scene, triangles=torch.cat([scene.triangles.double(), triangles.double()]))
    columns, rows = scene.receiver.samples
    factor = 1.0 if scene.receiver.albedo is not None else WHITE_PAPER
    grid, beyond = (
        relight(s, light, GROUND_RAYS).float() * factor for s in (both, replace(both, triangles=both.triangles[:0]))
    )
    return Ground(
        grid.T.reshape(rows, columns, 3).contiguous(), beyond.mean(dim=1), scene.receiver.center, scene.receiver.size
    )


def top_of(scene: Scene, triangles: Float[Tensor, "faces 3 3"]) -> float:
    """Returns a height above both objects."""
    parts = (scene.triangles, triangles, torch.zeros(1, 3, 3))
    heights = torch.cat([part.reshape(-1, 3)[:, 2].double().cpu() for part in parts])
    return heights.max().item() + max(scene.receiver.size)


def check_albedo(material: Material, scene: Scene) -> None:
    """Raises ConfigError where an albedo is above 1 though the plane's own is known, so that it is no relative one."""
    if scene.receiver.albedo is not None and max(material.albedo) > 1:
        raise ConfigError(f"albedo: expected at most 1, got {list(material.albedo)}; the plane's own albedo is stated")
