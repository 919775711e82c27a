"""A photograph by Mitsuba without an object, and the same with the object really there: direct light alone.

The block of the paper's experiment, here of albedo 0.3, stands on a plane of albedo 0.8 that goes on beyond the
picture. The camera is that of the rendered photographs: 400 x 300 pixels, a barrel lens, 45 degrees. Integrator: `path`
with max_depth 2, so that nothing throws light on anything else. The objects are Mitsuba's own sphere, cylinder and
mesh loader; torchlight gets the inscribed polyhedra of `geometry.primitives`, or reads the mesh itself.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from paper.setting import PHOTOGRAPHED, RECEIVER
from torch import Tensor

from torchlight.camera import Camera
from torchlight.geometry import primitives
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import rotation_matrix
from torchlight.insertion.placing import UPRIGHT, stood
from torchlight.io.atomic import write_atomically
from torchlight.io.cache import content_key
from torchlight.io.meshes import read_mesh
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.synthetic import block_scene

from .objects import Shape, distant, matt, plane, standing
from .photograph import photograph, renderer
from .probes import ALBEDO, camera

BLOCK_ALBEDO = 0.3
TABLE = 60.0  # edge of the plane
COLOUR = (0.7, 0.45, 0.2)
SPHERE, CYLINDER = 0.4, (0.3, 0.7)
BUNNY_HEIGHT = 0.9
VERSION = "inserted-1"  # in the key of stored pictures: raise it when they change


@dataclass(frozen=True, eq=False)
class Thing:
    """An object to be inserted.

    Attributes:
        name: in the table.
        triangles: in the world, for torchlight.
        shapes: the same for Mitsuba.
    """

    name: str
    triangles: Float[Tensor, "faces 3 3"]
    shapes: Callable[[], dict[str, Shape]]


def scene() -> Scene:
    """Returns what torchlight is told."""
    receiver = replace(RECEIVER, albedo=(ALBEDO, ALBEDO, ALBEDO))
    return Scene(block_scene(PHOTOGRAPHED, receiver).triangles, receiver, camera(), encoding="srgb")


def coloured() -> Shape:
    """Returns the object's surface, from both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(COLOUR)}}}


def sphere_at(name: str, x: float, y: float) -> Thing:
    """Returns a sphere on the plane."""
    place = {"type": "sphere", "center": [x, y, SPHERE], "radius": SPHERE}
    triangles = stood(primitives.sphere(SPHERE), (x, y))
    return Thing(name, triangles, lambda: {"thing": {**place, "bsdf": coloured()}})


def cylinder_at(name: str, x: float, y: float) -> Thing:
    """Returns an upright cylinder on the plane."""
    radius, height = CYLINDER

    def shapes() -> dict[str, Shape]:
        side = {"type": "cylinder", "p0": [x, y, 0.0], "p1": [x, y, height], "radius": radius, "bsdf": coloured()}
        lid = renderer().ScalarTransform4f().translate([x, y, height]).scale([radius, radius, 1.0])
        return {"side": side, "lid": {"type": "disk", "to_world": lid, "bsdf": coloured()}}

    return Thing(name, stood(primitives.cylinder(radius, height), (x, y)), shapes)


def bunny_at(name: str, file: Path, x: float, y: float, turn_degrees: float) -> Thing:
    """Returns the mesh of a file whose up is y, on the plane."""
    mesh = read_mesh(file)
    low, high = mesh[..., 1].min().item(), mesh[..., 1].max().item()
    scale = BUNNY_HEIGHT / (high - low)
    triangles = stood(mesh, (x, y), turn_degrees, scale, "y")
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (rotation_matrix((0.0, 0.0, turn_degrees)) @ rotation_matrix(UPRIGHT["y"])).numpy()
    matrix[:3, 3] = triangles[0, 0].numpy() - matrix[:3, :3] @ mesh[0, 0].numpy()

    def shapes() -> dict[str, Shape]:
        place = renderer().ScalarTransform4f(matrix.tolist())
        return {"thing": {"type": "obj", "filename": str(file), "to_world": place, "bsdf": coloured()}}

    return Thing(name, triangles, shapes)


def things(data: Path | None) -> list[Thing]:
    """Returns a sphere before the block and one half behind it, a cylinder beside it, and with data a bunny."""
    found = [
        sphere_at("sphere", 0.95, -0.75),
        sphere_at("half-hidden sphere", -0.75, 0.75),
        cylinder_at("cylinder", 0.8, 0.25),
    ]
    if data is not None:
        found.append(bunny_at("bunny", data / "meshes" / "stanford-bunny.obj", 0.85, -0.6, 30.0))
    return found


def seen(
    environment: EnvironmentMap, shapes: dict[str, Shape], samples: int, seed: int, block: bool = True
) -> Float[Tensor, "3 height width"]:
    """Returns the linear radiance that the camera sees of the plane, the block and further shapes."""
    objects = {
        "sheet": plane((0.0, 0.0), (TABLE, TABLE), matt(ALBEDO)),
        "light": distant(environment),
        **({"block": standing(PHOTOGRAPHED, matt(BLOCK_ALBEDO))} if block else {}),
        **shapes,
    }
    return photograph(objects, view(), samples, depth=2, seed=seed)


@dataclass(frozen=True, eq=False)
class Shot:
    """One rendering by Mitsuba.

    Attributes:
        samples: light paths per pixel.
        seed: of the random numbers.
        block: whether the block stands there.
        thing: what stands there too.
    """

    samples: int
    seed: int
    block: bool = True
    thing: Thing | None = None


def kept(environment: EnvironmentMap, shot: Shot, folder: Path) -> Float[Tensor, "3 height width"]:
    """Returns `seen`, from its file in `folder` or rendered and stored there: in float32 both times."""
    triangles = torch.zeros(0, 3, 3) if shot.thing is None else shot.thing.triangles
    setting = (
        f"{VERSION} {shot.samples} {shot.seed} {shot.block} {PHOTOGRAPHED} {TABLE} {ALBEDO} {BLOCK_ALBEDO} {COLOUR} "
        f"{camera().intrinsics} {camera().distortion}"
    )
    parts = {"radiance": environment.radiance, "triangles": triangles.double(), "setting": setting}
    path = folder / f"{content_key(parts)}.npz"
    if not path.exists():
        shapes = {} if shot.thing is None else shot.thing.shapes()
        picture = seen(environment, shapes, shot.samples, shot.seed, shot.block)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, radiance=picture.float().numpy())
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, buffer.getvalue())
    with np.load(path) as data:
        return torch.from_numpy(data["radiance"]).double()


def quieter(
    noisy: Float[Tensor, "3 height width"],
    empty: Float[Tensor, "3 height width"],
    environment: EnvironmentMap,
    shows_plane: Bool[Tensor, "height width"],
) -> Float[Tensor, "3 height width"]:
    """Returns a rendering with less noise where it shows the plane, and with the same expectation.

    The empty plane is known, v = albedo E / pi. Its rendering by the same random numbers is off by noise that the
    rendering with objects shares, the more so the less is hidden: b = rendering / v, smoothed, of it is taken away.
    """
    known = ALBEDO / torch.pi * irradiance(environment).double()[:, None, None]
    share = torch.nn.functional.avg_pool2d((noisy / known)[None], 7, 1, 3, count_include_pad=False)[0].clamp(0, 1)
    return torch.where(shows_plane, noisy - share * (empty - known), noisy)


def view() -> Camera:
    """Returns the camera."""
    return camera()


def codes(linear: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 height width"]:
    """Returns 8-bit sRGB codes as numbers."""
    from torchlight.photo.radiometry import encode

    return (encode(linear.clamp(0, 1).double(), "srgb") * 255).round()


def rim(mask: Tensor) -> Tensor:
    """Returns pixels within one of the mask's edge, on either side."""
    layer = mask[None, None].float()
    grown = torch.nn.functional.max_pool2d(layer, 3, 1, 1)[0, 0] > 0
    shrunk = -torch.nn.functional.max_pool2d(-layer, 3, 1, 1)[0, 0] > 0
    return grown & ~shrunk
