"""Ground truth by Mitsuba 3: its own renderer, rays, light sampling and footprint averages; nothing of torchlight's.

An orthographic camera looks straight down on a white plane of the receiver's size; every pixel is one sample, averaged
over its footprint by the sampler. The block is black, so that nothing is reflected between the two. The integrator is
`direct` with light sampling alone.

Noise is kept low by a second rendering of the empty plane with the same random numbers:

    v(x) = mean over x' of empty(x')  +  with block(x) - empty(x)

has the same expectation as "with block" alone, and only the hidden part of the light is noisy.

Mitsuba interpolates an environment map bilinearly, with row r at theta = pi r / (H - 1) and column c at
(c + 1/2) / W. `constant_per_pixel` hands it a finer map whose interpolation is the map that is constant over each
pixel, but for a symmetric ramp of one fine pixel across every pixel edge.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap
from torchlight.light.formats import to_latlong

VARIANT = "scalar_rgb"
FINE_ROWS = 2048  # rows at least, of the map that Mitsuba interpolates
ABOVE = 10.0  # height of the camera, in the receiver's width
SEED = 1


def installed() -> bool:
    """Returns whether Mitsuba can be imported."""
    return importlib.util.find_spec("mitsuba") is not None


def block_renderer(
    receiver: Receiver, environment: EnvironmentMap, samples: int
) -> Callable[[Block], Float[Tensor, "3 points"]]:
    """Returns the function from a pose to v = E / pi of every sample for albedo 1; the empty plane is rendered once.

    Args:
        receiver: the plane's samples.
        environment: the light.
        samples: light samples for every sample of the receiver, in each rendering; Mitsuba rounds up.
    """
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant(VARIANT)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # it warns that it rounds the samples up
    scene = plane_scene(mitsuba, receiver, mitsuba.Bitmap(constant_per_pixel(environment)), samples)

    def picture(objects: dict[str, Any]) -> Float[Tensor, "rows columns 3"]:
        """Returns the plane from above, row 0 at the largest y."""
        rendered = mitsuba.render(mitsuba.load_dict({**scene, **objects}), seed=SEED)
        return torch.from_numpy(np.array(rendered)[..., :3]).double()

    empty = picture({})

    def values(block: Block) -> Float[Tensor, "3 points"]:
        seen = empty.mean(dim=(0, 1)) + picture({"block": box(mitsuba, block)}) - empty
        return seen.flip(0).reshape(receiver.points, 3).T.contiguous()

    return values


def constant_per_pixel(environment: EnvironmentMap, rows_at_least: int | None = None) -> np.ndarray:
    """Returns the upper half of a map, [rows, columns, 3], for Mitsuba's bilinear interpolation; black below.

    Every pixel is repeated k x k times, and rows of sample points are added on the edges between pixels, where they
    hold the mean of both: k H + 1 rows at theta = i pi / (k H).

    Args:
        environment: H rows.
        rows_at_least: of k H, k being at least 2; None = FINE_ROWS.
    """
    height = environment.height
    fine = max(2, math.ceil((FINE_ROWS if rows_at_least is None else rows_at_least) / height))
    radiance = environment.radiance.float().clone()
    radiance[:, height // 2 :] = 0.0
    turned = to_latlong(radiance, "mitsuba").repeat_interleave(fine, dim=-1)
    rows = turned.repeat_interleave(fine, dim=-2)
    above = torch.cat([rows[:, :1], rows], dim=-2)
    below = torch.cat([rows, rows[:, -1:]], dim=-2)
    return ((above + below) / 2).permute(1, 2, 0).contiguous().numpy()


def plane_scene(mitsuba: ModuleType, receiver: Receiver, light: object, samples: int) -> dict[str, Any]:
    """Returns the lit plane under an orthographic camera, one pixel per sample."""
    transform = mitsuba.ScalarTransform4f
    (x, y), (width, depth) = receiver.center, receiver.size
    place = transform().translate([x, y, 0.0]).scale([width / 2, depth / 2, 1.0])
    columns, rows = receiver.samples
    return {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": {
            "type": "orthographic",
            "to_world": transform()
            .translate([x, y, 0.0])
            .look_at(origin=[0.0, 0.0, ABOVE * width], target=[0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0])
            .scale([width / 2, width / 2, 1.0]),
            "film": {
                "type": "hdrfilm",
                "width": columns,
                "height": rows,
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
        "plane": {"type": "rectangle", "to_world": place, "bsdf": diffuse(1.0)},
        "light": {
            "type": "envmap",
            "bitmap": light,
            "to_world": transform().rotate([1.0, 0.0, 0.0], 90.0),
        },
    }


def box(mitsuba: ModuleType, block: Block) -> dict[str, Any]:
    """Returns the black block as Mitsuba's cube [-1, 1]^3, scaled, turned and moved."""
    width, depth, height = block.size
    turned = (
        mitsuba.ScalarTransform4f()
        .translate([*block.translation, height / 2])
        .rotate([0.0, 0.0, 1.0], block.rotation_degrees)
        .scale([width / 2, depth / 2, height / 2])
    )
    return {"type": "cube", "to_world": turned, "bsdf": diffuse(0.0)}


def diffuse(albedo: float) -> dict[str, Any]:
    """Returns a grey Lambertian surface."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
