"""Photographs by Mitsuba 3 as a camera with lens distortion takes them, and the files that a camera makes of them.

Mitsuba knows pinholes only. A pinhole picture is rendered at the camera's place, wide enough for everything that the
lens sees and finer than the photograph. A pixel of the photograph is the mean over its own square, on the sensor,
of what that picture holds:

    photo(p) = mean over q in p + [-1/2, 1/2]^2 of pinhole(undistort(q)),

by SUBPOINTS x SUBPOINTS points q and bilinear interpolation. Mitsuba's own box filter averages each fine pixel.

Conventions: Mitsuba's camera looks along +z with x to the left and y up; OpenCV's has x to the right and y down.
Mitsuba counts from the corner of the first pixel, OpenCV (and torchlight) from its centre.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.camera import Camera, pixel_directions
from torchlight.photo.radiometry import encode

FINER = 2.0  # pixels of the pinhole picture along a pixel of the photograph, in the middle
SUBPOINTS = 4  # along a pixel's edge
MARGIN = 2.0  # fine pixels round everything that the lens sees
LANES = 2**24  # rays that Mitsuba's vectorised variant holds at once


def installed() -> bool:
    """Returns whether Mitsuba can be imported."""
    return importlib.util.find_spec("mitsuba") is not None


@cache
def renderer() -> ModuleType:
    """Returns Mitsuba: "llvm_ad_rgb" where DRJIT_LIBLLVM_PATH names an LLVM, else "scalar_rgb", which always works.

    The first is five times as fast. It is not tried unasked: an LLVM older than the processor ends the process.
    """
    mitsuba = importlib.import_module("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb" if "DRJIT_LIBLLVM_PATH" in os.environ else "scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # it warns that it rounds the samples up
    return mitsuba


@dataclass(frozen=True)
class Pinhole:
    """A pinhole picture without distortion: pixels are squares, centres at integers.

    Attributes:
        focal: in its pixels.
        middle: its principal point, column and row.
        size: columns and rows.
    """

    focal: float
    middle: tuple[float, float]
    size: tuple[int, int]


def photograph(
    mitsuba_objects: dict[str, Any], camera: Camera, samples: int, depth: int = -1, seed: int = 1
) -> Float[Tensor, "3 height width"]:
    """Returns the linear radiance that a camera with lens distortion sees, by Mitsuba's `path` integrator.

    Args:
        mitsuba_objects: shapes and emitters by name, as `mitsuba.load_dict` takes them; the world is torchlight's.
        camera: intrinsics, distortion and pose.
        samples: light paths per pixel of the photograph, about.
        depth: of the paths, as Mitsuba counts: 2 = direct light alone, -1 = all interreflection.
        seed: of the random numbers.
    """
    rays = sensor_rays(camera)
    pinhole = pinhole_around(rays, camera)
    integrator = {"type": "path", "max_depth": depth}
    fine = pinhole_picture(mitsuba_objects, camera, pinhole, max(1, round(samples / FINER**2)), integrator, seed)
    return through_the_lens(fine, rays, pinhole)


def sensor_rays(camera: Camera) -> Float[Tensor, "height width sub 2"]:
    """Returns x / z and y / z, in camera axes, of the points that a pixel's square is averaged over.

    The lens is taken as linear over a pixel: u(p + d) = u(p) + J d, J by central differences between pixel centres.
    """
    width, height = camera.image_size
    rows, columns = torch.meshgrid(torch.arange(-1, height + 1), torch.arange(-1, width + 1), indexing="ij")
    local = pixel_directions(camera, torch.stack([columns, rows], dim=-1).double())
    local = local @ camera.world_to_camera.double()[:3, :3].T
    center = local[..., :2] / local[..., 2:]
    right = (center[1:-1, 2:] - center[1:-1, :-2]) / 2
    down = (center[2:, 1:-1] - center[:-2, 1:-1]) / 2
    step = (torch.arange(SUBPOINTS, dtype=torch.float64) + 0.5) / SUBPOINTS - 0.5
    x, y = torch.cartesian_prod(step, step)[:, :, None].unbind(dim=1)
    return center[1:-1, 1:-1, None] + x * right[:, :, None] + y * down[:, :, None]


def pinhole_around(rays: Float[Tensor, "height width sub 2"], camera: Camera) -> Pinhole:
    """Returns the pinhole picture that holds all rays, FINER than the photograph where it is finest."""
    focal = FINER * max(camera.intrinsics[0, 0].item(), camera.intrinsics[1, 1].item())
    low = rays.flatten(end_dim=2).amin(dim=0) * focal - MARGIN
    high = rays.flatten(end_dim=2).amax(dim=0) * focal + MARGIN
    columns, rows = (high - low).ceil().long().tolist()
    return Pinhole(focal, (-low[0].item(), -low[1].item()), (columns + 1, rows + 1))


def pinhole_picture(
    objects: dict[str, Any], camera: Camera, pinhole: Pinhole, samples: int, integrator: dict[str, Any], seed: int
) -> Float[Tensor, "3 rows columns"]:
    """Returns Mitsuba's picture, rendered in parts that its memory holds, each with random numbers of its own."""
    mitsuba = renderer()
    part = max(1, min(samples, LANES // (pinhole.size[0] * pinhole.size[1])))
    parts = -(-samples // part)
    scene = {"type": "scene", "integrator": integrator, "sensor": sensor(mitsuba, camera, pinhole, part), **objects}
    loaded = mitsuba.load_dict(scene)
    total = sum(
        np.array(mitsuba.render(loaded, seed=seed * 1_000_003 + k), dtype=np.float64)[..., :3] for k in range(parts)
    )
    return torch.from_numpy(np.asarray(total) / parts).permute(2, 0, 1).contiguous()


def sensor(mitsuba: ModuleType, camera: Camera, pinhole: Pinhole, samples: int) -> dict[str, Any]:
    """Returns Mitsuba's perspective sensor of a pinhole picture at a camera's place."""
    (columns, rows), (x, y) = pinhole.size, pinhole.middle
    axes = np.diag([-1.0, -1.0, 1.0, 1.0])
    to_world = np.linalg.inv(camera.world_to_camera.double().numpy()) @ axes
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(columns / 2 / pinhole.focal))),
        "principal_point_offset_x": 0.5 - (x + 0.5) / columns,
        "principal_point_offset_y": 0.5 - (y + 0.5) / rows,
        "near_clip": 1e-3,
        "far_clip": 1e5,
        "to_world": mitsuba.ScalarTransform4f(to_world.tolist()),
        "film": {
            "type": "hdrfilm",
            "width": columns,
            "height": rows,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def through_the_lens(
    fine: Float[Tensor, "3 rows columns"], rays: Float[Tensor, "height width sub 2"], pinhole: Pinhole
) -> Float[Tensor, "3 height width"]:
    """Returns the photograph that the lens makes of a pinhole picture: each pixel the mean over its own rays."""
    places = rays * pinhole.focal + torch.tensor(pinhole.middle, dtype=torch.float64)
    below = places.floor().long()
    share = places - below
    rows, columns = below[..., 1], below[..., 0]
    total = torch.zeros(3, *rays.shape[:3], dtype=fine.dtype)
    for down in (0, 1):
        for right in (0, 1):
            weight = (share[..., 1] if down else 1 - share[..., 1]) * (share[..., 0] if right else 1 - share[..., 0])
            total += fine[:, rows + down, columns + right] * weight
    return total.mean(dim=-1)


def stored(linear: Float[Tensor, "3 height width"], exposure: float, noise: float, seed: int) -> NDArray[np.uint8]:
    """Returns the 8-bit sRGB photograph [height, width, RGB] of linear radiance.

    round(255 sRGB(clip(exposure L + n, 0, 1))), n independent per pixel and channel, Gaussian, of standard deviation
    `noise` in linear units of the file's white (linear 1 = code 255). With an exposure that brings the brightest pixel
    of the plane to 1, `noise` = 0.01 is 1 % of that pixel.

    Args:
        linear: radiance.
        exposure: factor that takes radiance to the file's linear scale.
        noise: standard deviation, a share of white.
        seed: of the noise.
    """
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randn(linear.shape, generator=generator, dtype=torch.float64)
    values = (linear.double() * exposure + noise * drawn).clamp(0, 1)
    return (encode(values, "srgb") * 255).round().byte().permute(1, 2, 0).contiguous().numpy()
