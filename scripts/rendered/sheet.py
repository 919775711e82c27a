"""The printed sheet on a table, the block on it and a lamp far away, as objects of Mitsuba's own.

The print is the PNG of `torchlight target`, as large as the resolution in the file says; a stored value is taken as the
share of bare paper between ink and paper. World: that of the sheet, millimetres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from torchlight.camera import Camera, project
from torchlight.photo.target import Prop, Sheet

from .photograph import photograph, renderer

PAPER, INK, TABLE = 0.85, 0.04, 0.25  # Lambertian albedos
EBONY = 0.05
MILLIMETRES_PER_INCH = 25.4
FAR = 2e5  # of the lamp: over 300 mm its direction differs by 0.09 degrees, and its brightness by 0.3 % at most
THICKNESS = 0.1
TILE = 320  # pixels that are rendered at once
RIM = 30  # pixels round the page that are rendered; what lies beyond is the table


@dataclass(frozen=True)
class Lamp:
    """A round lamp far away, and light from everywhere else.

    Attributes:
        azimuth_degrees: counter-clockwise from x.
        elevation_degrees: above the sheet.
        radius_degrees: half of its angular diameter.
        ambient: radiance of the rest of the sphere, where the lamp alone would light the sheet like pi times 1.
    """

    azimuth_degrees: float
    elevation_degrees: float
    radius_degrees: float = 1.0
    ambient: float = 0.15

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector towards it."""
        azimuth, elevation = math.radians(self.azimuth_degrees), math.radians(self.elevation_degrees)
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def printed(picture: Path, sheet: Sheet) -> dict[str, Any]:
    """Returns the page on a larger table.

    Args:
        picture: the PNG of `torchlight target`; its resolution tells how many millimetres it covers from the page's
            lower left corner.
        sheet: where the world's origin lies on the page.
    """
    with Image.open(picture) as stored:
        grey = np.asarray(stored.convert("L"), dtype=np.float32) / 255
        dots = stored.info["dpi"]
    size = [pixels / per_inch * MILLIMETRES_PER_INCH for pixels, per_inch in zip(grey.shape[::-1], dots, strict=True)]
    middle = [size[axis] / 2 - sheet.origin[axis] for axis in (0, 1)]
    mitsuba = renderer()
    # Mitsuba's v runs up the page
    reflectance = INK + grey[::-1, :, None] * (PAPER - INK)
    texture = {"type": "bitmap", "bitmap": mitsuba.Bitmap(np.ascontiguousarray(reflectance)), "raw": True}
    page = {"type": "rectangle", "to_world": _lying(mitsuba, middle, size, 0.0)}
    table = {"type": "rectangle", "to_world": _lying(mitsuba, middle, [4 * size[0], 4 * size[1]], -THICKNESS)}
    return {
        "page": {**page, "bsdf": {"type": "diffuse", "reflectance": {**texture, "wrap_mode": "clamp"}}},
        "table": {**table, "bsdf": _diffuse(TABLE)},
    }


def lights(lamp: Lamp) -> list[dict[str, Any]]:
    """Returns the lamp, as bright that it alone gives the sheet the irradiance pi, and the ambient light where any is.

    They are rendered one by one and added: Mitsuba draws an emitter for every sample, and that choice is noise.
    """
    transform = renderer().ScalarTransform4f
    place = (FAR * lamp.direction).tolist()
    sine = math.sin(math.radians(lamp.radius_degrees))
    radiance = 1.0 / (sine**2 * math.sin(math.radians(lamp.elevation_degrees)))  # E = pi L sin^2(radius) sin(elevation)
    facing = transform().look_at(origin=place, target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0])
    across = FAR * math.tan(math.radians(lamp.radius_degrees))
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    disk = {"type": "disk", "to_world": facing @ transform().scale([across, across, 1.0]), "emitter": emitter}
    ambient = {"type": "constant", "radiance": {"type": "rgb", "value": lamp.ambient}}
    return [{"lamp": disk}, {"ambient": ambient}] if lamp.ambient > 0 else [{"lamp": disk}]


def standing(prop: Prop, albedo: float = EBONY) -> dict[str, Any]:
    """Returns a box on its footprint."""
    if prop.shape != "box":
        raise ValueError(f"expected a box, got {prop.shape}")
    mitsuba = renderer()
    x, y, height = prop.size
    turned = (
        mitsuba.ScalarTransform4f()
        .translate([*prop.position, height / 2])
        .rotate([0.0, 0.0, 1.0], prop.turn_degrees)
        .scale([x / 2, y / 2, height / 2])
    )
    return {"block": {"type": "cube", "to_world": turned, "bsdf": _diffuse(albedo)}}


def card(center: tuple[float, float], size: tuple[float, float]) -> dict[str, Any]:
    """Returns a grey card that lies on the sheet and hides what is under it."""
    place = _lying(renderer(), list(center), list(size), THICKNESS)
    return {"card": {"type": "rectangle", "to_world": place, "bsdf": _diffuse(TABLE)}}


def looking_at(place: tuple[float, float, float], at: tuple[float, float], roll_degrees: float) -> Float[Tensor, "4 4"]:
    """Returns world to camera of a camera that looks at a point of the sheet, rolled about the line of sight.

    Unrolled, its x axis is level. ValueError straight above the point.
    """
    forward = torch.tensor([at[0] - place[0], at[1] - place[1], -place[2]], dtype=torch.float64)
    forward = torch.nn.functional.normalize(forward, dim=0)
    if forward[:2].norm() < 1e-6:
        raise ValueError("straight above: no direction is level with the camera's x axis")
    level = torch.nn.functional.normalize(torch.stack([forward[1], -forward[0], torch.zeros(()).double()]), dim=0)
    below = torch.linalg.cross(forward, level)
    cosine, sine = math.cos(math.radians(roll_degrees)), math.sin(math.radians(roll_degrees))
    rotation = torch.stack([cosine * level + sine * below, cosine * below - sine * level, forward])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ torch.tensor(place, dtype=torch.float64)
    return pose


def picture(
    objects: dict[str, Any], camera: Camera, sheet: Sheet, lamp: Lamp, samples: int, depth: int
) -> Float[Tensor, "3 height width"]:
    """Returns the linear photograph: rendered in tiles round the page, the lit table's radiance elsewhere."""
    width, height = camera.image_size
    seen = torch.full((3, height, width), TABLE * (1 + lamp.ambient), dtype=torch.float64)
    columns, rows = _around_the_page(camera, sheet)
    corners = [(x, y) for y in range(rows[0], rows[1], TILE) for x in range(columns[0], columns[1], TILE)]
    for seed, (x, y) in enumerate(corners, start=1):
        size = (min(TILE, columns[1] - x), min(TILE, rows[1] - y))
        part = _cut(camera, (x, y), size)
        shown = [photograph({**objects, **light}, part, samples, depth, seed) for light in lights(lamp)]
        seen[:, y : y + size[1], x : x + size[0]] = sum(shown)
    return seen


def _around_the_page(camera: Camera, sheet: Sheet) -> list[tuple[int, int]]:
    """Returns first and last + 1 of the columns, then of the rows, that show the page."""
    (x, y), (width, height) = sheet.origin, sheet.paper
    steps = [0.0, 0.25, 0.5, 0.75, 1.0]  # a distorted side is not straight
    rim = [[a * width - x, b * height - y, 0.0] for a in steps for b in steps]
    shown = project(camera, torch.tensor(rim, dtype=torch.float64))
    low, high = (shown.amin(dim=0) - RIM).long().tolist(), (shown.amax(dim=0) + RIM).long().tolist()
    return [(max(0, a), min(limit, b)) for a, b, limit in zip(low, high, camera.image_size, strict=True)]


def _cut(camera: Camera, corner: tuple[int, int], size: tuple[int, int]) -> Camera:
    """Returns the camera of a part of the photograph."""
    moved = camera.intrinsics.clone()
    moved[0, 2] -= corner[0]
    moved[1, 2] -= corner[1]
    return Camera(moved, camera.world_to_camera, size, camera.distortion)


def _lying(mitsuba: ModuleType, middle: list[float], size: list[float], z: float) -> object:
    transform = mitsuba.ScalarTransform4f
    return transform().translate([*middle, z]).scale([size[0] / 2, size[1] / 2, 1.0])


def _diffuse(albedo: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
