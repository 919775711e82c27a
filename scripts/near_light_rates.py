"""How often the near-light test warns of distant light, how often of a lamp at 0.5 to 1 m, and its drift's error.

    python scripts/near_light_rates.py --data DIR [--distant 20] [--near 10] [--seed 1]

Photographs are Mitsuba's, which shares nothing with torchlight: an orthographic camera from above, a white plane of
300 mm, a black object of 30 to 110 mm (a block, a pole, the chair of DIR/meshes), a lamp of 8 to 25 mm radius with a
grey sky of a tenth to two fifths of the light, 8-bit sRGB with 1 % noise. Distant photographs are lit by probes of
DIR/probes in turn with such lamps 200 times as far and as large.
"""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
import tyro
from jaxtyping import Float
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from paper.mitsuba_truth import VARIANT, constant_per_pixel, diffuse, installed, plane_scene
from torch import Tensor

from torchlight.geometry.footprints import footprint_points
from torchlight.geometry.primitives import box, cone, cylinder
from torchlight.geometry.receiver import Receiver, receiver_corners
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.geometry.visibility import scene_occlusion
from torchlight.io.lights import read_light
from torchlight.io.meshes import read_mesh
from torchlight.light.environment import EnvironmentMap
from torchlight.near_light.verdict import NearLight, near_light
from torchlight.photo.observation import linear_photo
from torchlight.pipeline import observe
from torchlight.synthetic import receiver_image

RECEIVER = Receiver((0.0, 0.0), (300.0, 300.0), (64, 64))  # mm
PROBES = ("probulator_pisa", "studio_small_05_1k", "aerodynamics_workshop_1k")
LIGHT_SAMPLES = 256
FAR = 200.0
CAMERA = 0.5  # height of the orthographic camera, in the receiver's width: below any lamp


class Draw:
    """Uniform random numbers."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def between(self, low: float, high: float) -> float:
        """Returns one number."""
        return low + (high - low) * float(torch.rand(1, generator=self.generator, dtype=torch.float64))


@dataclass(frozen=True, eq=False)
class Rendered:
    """A photograph, its scene and the lamp's place; None for distant light."""

    kind: str
    light: str
    scene: Scene
    image: Float[Tensor, "3 rows columns"]
    lamp: Float[Tensor, "3"] | None


def main(data: Path | None = None, distant: int = 20, near: int = 10, seed: int = 1, reference: str = "smooth") -> None:
    """Prints a line per photograph and the rates.

    Args:
        data: folder that holds probes/ and meshes/; default: the environment variable TORCHLIGHT_DATA.
        distant: photographs under distant light.
        near: photographs under a near lamp.
        seed: of objects, lamps and noise.
        reference: of the scenes, "smooth" or "uniform".
    """
    root = data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))
    if not (root / "meshes").exists():
        sys.exit(f"near_light_rates: no meshes in '{root}'; pass --data DIR or set TORCHLIGHT_DATA")
    if not installed():
        sys.exit("near_light_rates: Mitsuba is not installed; pip install mitsuba")
    print("| object | light | p | near | drift, degrees | true | off by |\n| --- | --- | --- | --- | --- | --- | --- |")
    alarms = sum(judged(distant_photo(root, seed, index, reference)).flagged for index in range(distant))
    found, errors = 0, []
    for index in range(near):
        photo = lamp_photo(root, Draw(10_000 * seed + 5000 + index), index, reference, 1.0)
        verdict = judged(photo)
        found += verdict.flagged
        errors.append(abs(verdict.drift_degrees / true_drift(photo) - 1))
    print(f"\nflagged: {alarms} of {distant} distant, {found} of {near} near")
    if errors:
        middle = sorted(errors)[len(errors) // 2]
        print(f"drift off by {100 * middle:.0f} % (median), {100 * max(errors):.0f} % (worst)")


def judged(photo: Rendered) -> NearLight:
    """Returns the verdict on a photograph and prints its line."""
    verdict = near_light(photo.scene, observe(linear_photo(photo.image), photo.scene))
    if verdict is None:
        sys.exit("near_light_rates: a photograph has too few samples")
    truth = true_drift(photo)
    off = f"{100 * (verdict.drift_degrees / truth - 1):+.0f} %" if truth > 0 else "-"
    drift = f"{verdict.drift_degrees:.1f} +- {verdict.deviation_degrees:.1f}"
    row = (photo.kind, photo.light, f"{verdict.p_value:.2g}", "yes" if verdict.flagged else "no", drift, f"{truth:.1f}")
    print(f"| {' | '.join(row)} | {off} |", flush=True)
    return verdict


def true_drift(photo: Rendered) -> float:
    """Returns the largest angle between the directions from two corners of the receiver to the lamp."""
    if photo.lamp is None:
        return 0.0
    towards = torch.nn.functional.normalize(photo.lamp - receiver_corners(RECEIVER), dim=-1)
    return math.degrees(float((towards @ towards.T).clamp(-1, 1).acos().max()))


def distant_photo(root: Path, seed: int, index: int, reference: str) -> Rendered:
    """Returns a photograph under a probe, or every other time under a distant lamp."""
    draw = Draw(10_000 * seed + index)
    if index % 2:
        return lamp_photo(root, draw, index // 2, reference, FAR)
    name, kind = PROBES[index // 2 % len(PROBES)], ("block", "chair")[index // 2 % 2]
    radiance = read_light(root / "probes" / f"{name}.hdr", "blender").radiance
    turned = EnvironmentMap(radiance.roll(int(draw.between(0, radiance.shape[-1])), -1))
    mitsuba = renderer()
    upright = mitsuba.ScalarTransform4f().rotate([1.0, 0.0, 0.0], 90.0)
    light = {"type": "envmap", "bitmap": mitsuba.Bitmap(constant_per_pixel(turned)), "to_world": upright}
    triangles = solid(root, kind, draw)
    empty = rendered(None, light)
    values = rendered(triangles, light) - empty + empty.mean(dim=1, keepdim=True)
    return photograph(kind, name, triangles, values, None, draw, reference)


def lamp_photo(root: Path, draw: Draw, index: int, reference: str, farther: float) -> Rendered:
    """Returns a photograph under a lamp and a grey sky; the lamp so many times as far and as large."""
    kind = ("block", "chair")[index % 2]
    triangles = solid(root, kind, draw)
    elevation, azimuth = math.radians(draw.between(30, 60)), math.radians(draw.between(0, 360))
    level, distance = math.cos(elevation), draw.between(500, 1000) * farther
    towards = [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)]
    place = torch.tensor(towards, dtype=torch.float64) * distance
    radius = draw.between(8, 25) * farther
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    lit = rendered(triangles, {"type": "sphere", "center": place.tolist(), "radius": radius, "emitter": emitter})
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    grey = rendered(triangles, sky) - rendered(None, sky) + 1
    share = draw.between(0.1, 0.4)
    values = (1 - share) * lit / lit.mean() + share * grey
    name = f"lamp at {distance / 1000:.2f} m"
    return photograph(kind, name, triangles, values, place if farther == 1 else None, draw, reference)


def solid(root: Path, kind: str, draw: Draw) -> Float[Tensor, "faces 3 3"]:
    """Returns a random object near the receiver's middle, in mm."""
    if kind == "block":
        triangles = box((draw.between(25, 45), draw.between(25, 45), draw.between(30, 45)))
    elif kind == "pole":
        point = transform(cone(4.5, 22.0), 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 90.0))
        triangles = torch.cat([cylinder(4.5, 90.0), point])
    else:
        triangles = upright_chair(read_mesh(next((root / "meshes").glob("chair*"))).double(), 60.0)
    turn, x, y = draw.between(0, 360), draw.between(-20, 20), draw.between(-20, 20)
    return transform(triangles, 1.0, (0.0, 0.0, turn), (x, y, 0.0))


def upright_chair(mesh: Float[Tensor, "faces 3 3"], height: float) -> Float[Tensor, "faces 3 3"]:
    """Returns the chair, whose file has y up, standing on the origin."""
    turned = torch.stack([mesh[..., 0], -mesh[..., 2], mesh[..., 1]], dim=-1)
    low, high = turned.reshape(-1, 3).amin(dim=0), turned.reshape(-1, 3).amax(dim=0)
    foot = torch.stack([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return (turned - foot) * (height / (high[2] - low[2]))


def photograph(
    kind: str,
    light: str,
    triangles: Float[Tensor, "faces 3 3"],
    values: Float[Tensor, "3 points"],
    lamp: Float[Tensor, "3"] | None,
    draw: Draw,
    reference: str,
) -> Rendered:
    """Returns values as an 8-bit sRGB camera with 1 % noise stores them, linear again."""
    noisy = values * (1 + 0.01 * torch.randn(values.shape, generator=draw.generator, dtype=torch.float64))
    scaled = (noisy / noisy.max() * 0.95).clamp(0, 1)[..., None]
    stored = rgb_to_linear_rgb((linear_rgb_to_rgb(scaled) * 255).round() / 255)[..., 0]
    scene = Scene(triangles, RECEIVER, reference=reference, mask=shown_from_above(triangles))
    return Rendered(kind, light, scene, receiver_image(stored, RECEIVER).float(), lamp)


def shown_from_above(triangles: Float[Tensor, "faces 3 3"]) -> Tensor:
    """Returns where the camera sees the plane and not the object, less a ring of one sample: a rectified mask."""
    test = scene_occlusion(Scene(triangles, RECEIVER))
    points = footprint_points(RECEIVER, 4).reshape(-1, 3).numpy()
    covered = torch.from_numpy(test.hidden(points, np.tile([[0.0, 0.0, 1.0]], (len(points), 1))))
    columns, rows = RECEIVER.samples
    grown = torch.nn.functional.max_pool2d(covered.reshape(rows, columns, -1).any(dim=-1)[None].float(), 3, 1, 1)[0]
    return ~(grown > 0).flip(0)


@cache
def renderer() -> ModuleType:
    """Returns Mitsuba, set up."""
    mitsuba = import_module("mitsuba")
    mitsuba.set_variant(VARIANT)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def rendered(triangles: Float[Tensor, "faces 3 3"] | None, light: dict[str, Any]) -> Float[Tensor, "3 points"]:
    """Returns the plane from above under a light, with a black object or without."""
    mitsuba = renderer()
    scene = plane_scene(mitsuba, RECEIVER, None, LIGHT_SAMPLES)
    width = RECEIVER.size[0]
    above = mitsuba.ScalarTransform4f().look_at(
        origin=[0.0, 0.0, CAMERA * width], target=[0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0]
    )
    scene["sensor"]["to_world"] = above.scale([width / 2, width / 2, 1.0])
    scene["light"] = light
    if triangles is not None:
        scene["object"] = black(triangles)
    picture = torch.from_numpy(np.array(mitsuba.render(mitsuba.load_dict(scene)))[..., :3]).double()
    return picture.flip(0).reshape(RECEIVER.points, 3).T.contiguous()


def black(triangles: Float[Tensor, "faces 3 3"]) -> object:
    """Returns a triangle soup that reflects nothing."""
    corners = np.ascontiguousarray(triangles.float().numpy().reshape(-1, 3))
    mitsuba = renderer()
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "inner": diffuse(0.0)})
    mesh = mitsuba.Mesh("object", vertex_count=len(corners), face_count=len(corners) // 3, props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = corners.ravel()
    parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
    parameters.update()
    return mesh


if __name__ == "__main__":
    tyro.cli(main)
