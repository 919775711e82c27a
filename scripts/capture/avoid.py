"""What spoils a photograph, rendered on one scene: the plane from above under a lamp and a dim sky.

All pictures show linear light as sRGB, at one exposure but for the near lamp and the one that is exposed too long.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from torch import Tensor

from torchlight.drawing.canvas import png_bytes
from torchlight.drawing.content import UNUSED
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap
from torchlight.light.latlong import pixel_directions
from torchlight.light_plane import LightPlane
from torchlight.preview import to_srgb8
from torchlight.relighting import relight
from torchlight.view import standing_free

RECEIVER = Receiver((0.0, 0.0), (200.0, 150.0), (160, 120))
SIZE, TURN = (30.0, 20.0, 35.0), 30.0
AZIMUTH, ELEVATION, RADIUS = math.radians(35), math.radians(48), math.radians(2.0)
LAMP_SHARE = 0.8  # of the light on the plane
NEAR = 130.0  # mm above the sheet
FITTED = 0.55  # exposure of that photograph
CAMERA = (-190.0, -175.0, 220.0)  # mm, for the mirror image of the lamp
MAP_HEIGHT, RAYS = 256, 2_000
DARKEST = 0.04  # of the block itself
PLAIN = 0.62  # linear value of the lit plane


def avoid_picture() -> bytes:
    """Returns a PNG of six panels: a good photograph and five that are not."""
    figure = Figure(figsize=(12.6, 7.2), dpi=100, layout="constrained")
    for axis, (name, said, values) in zip(figure.subplots(2, 3).flat, panels(), strict=True):
        free = standing_free(scene())
        shown = torch.where(free, values, torch.full_like(values, UNUSED**2.2)).reshape(3, *RECEIVER.samples[::-1])
        axis.imshow(to_srgb8(shown.flip(1)), extent=(-100, 100, -75, 75))
        axis.set_title(name, fontsize=12)
        axis.set_xlabel(said, fontsize=10)
        axis.set_xticks([])
        axis.set_yticks([])
    return png_bytes(figure)


def panels() -> list[tuple[str, str, Float[Tensor, "3 points"]]]:
    """Returns name, remark and the plane's values of every panel."""
    lamp, sky = lights()
    fair = shown(scene(), lamp) + shown(scene(), sky)
    return [
        ("good", "white below saturation, all of the shadow in sight", fair),
        ("a lamp too near", "brighter below it, and the shadow widens", near_lamp(lamp, sky)),
        ("HDR or \"smart\" mode", "a bright rim round the shadow: local tone mapping", tone_mapped(fair)),
        ("glossy paper", "the lamp's mirror image, which moves with the camera", glossy(fair)),
        ("exposed too long", "the lit plane is saturated: dropped, only the shadow is left", (2.4 * fair).clamp(max=1)),
        ("in the light", "the phone's own shadow on the sheet: light that is missing", in_the_light(lamp, sky)),
    ]  # fmt: skip


def scene() -> Scene:
    """Returns the block on the plane, without a camera."""
    return Scene(transform(box(SIZE), 1.0, (0.0, 0.0, TURN), (0.0, 0.0, 0.0)), RECEIVER)


def lights() -> tuple[EnvironmentMap, EnvironmentMap]:
    """Returns lamp and sky, which together light the open plane to the value `PLAIN`."""
    directions = pixel_directions(MAP_HEIGHT)
    toward = lamp_direction()
    disc = ((directions @ toward) > math.cos(RADIUS)).double()
    flux = (disc * directions[..., 2].clamp(min=0) * pixel_areas()).sum()
    warm, cool = torch.tensor([1.0, 0.96, 0.88]), torch.tensor([0.9, 0.97, 1.08])
    lamp = (LAMP_SHARE * PLAIN * math.pi / flux) * disc
    sky = (1 - LAMP_SHARE) * PLAIN * (directions[..., 2] > 0)
    return EnvironmentMap(warm.double()[:, None, None] * lamp), EnvironmentMap(cool.double()[:, None, None] * sky)


def pixel_areas() -> Float[Tensor, "height 1"]:
    """Returns the solid angle of a pixel of every row."""
    edges = torch.linspace(0, math.pi, MAP_HEIGHT + 1, dtype=torch.float64).cos()
    return ((edges[:-1] - edges[1:]) * (math.pi / MAP_HEIGHT))[:, None]


def lamp_direction() -> Float[Tensor, "3"]:
    """Returns the unit vector towards the lamp."""
    angles = torch.tensor([math.pi / 2 - ELEVATION, AZIMUTH], dtype=torch.float64)
    return from_angles(angles[0], angles[1])


def shown(of: Scene, light: EnvironmentMap) -> Float[Tensor, "3 points"]:
    """Returns the plane's values under a light."""
    return relight(of, light, RAYS)


def near_lamp(lamp: EnvironmentMap, sky: EnvironmentMap) -> Float[Tensor, "3 points"]:
    """Returns the plane under the lamp at a height: E falls off as cos^4 of its zenith angle from each sample."""
    toward = lamp_direction()
    place = toward[:2] / toward[2] * NEAR
    away = (sample_centers(RECEIVER).double() - place).square().sum(-1)
    falloff = (NEAR**2 + place.square().sum()) ** 2 / (NEAR**2 + away) ** 2
    plane = LightPlane(NEAR)
    near = relight(replace(scene(), light_plane=plane), replace(lamp, plane=plane), RAYS)
    return (FITTED * (near * falloff + shown(scene(), sky))).clamp(max=1)


def tone_mapped(values: Float[Tensor, "3 points"]) -> Float[Tensor, "3 points"]:
    """Returns values whose large-scale contrast is halved: the Gaussian base of the logarithm, 8 samples wide."""
    image = values.clamp(min=DARKEST).log().reshape(3, *RECEIVER.samples[::-1]).numpy()
    base = np.stack([gaussian_filter(channel, 8) for channel in image])
    return torch.from_numpy(np.exp(image - 0.5 * (base - base.max()))).flatten(1)


def glossy(values: Float[Tensor, "3 points"]) -> Float[Tensor, "3 points"]:
    """Returns values with the lamp's blurred mirror image, where its rays are reflected to the camera."""
    toward = lamp_direction()
    spot = torch.tensor(CAMERA[:2]) + toward[:2] / toward[2] * CAMERA[2]
    away = (sample_centers(RECEIVER).double() - spot).square().sum(-1)
    return (values + 0.9 * torch.exp(-away / (2 * 13.0**2))).clamp(max=1)


def in_the_light(lamp: EnvironmentMap, sky: EnvironmentMap) -> Float[Tensor, "3 points"]:
    """Returns the plane with a phone held between it and the lamp."""
    toward = lamp_direction()
    x, y = (toward[:2] / toward[2] * 260 + torch.tensor([52.0, 20.0])).tolist()
    phone = transform(box((75.0, 150.0, 8.0)), 1.0, (25.0, 0.0, 40.0), (x, y, 260.0))
    both = replace(scene(), triangles=torch.cat([scene().triangles, phone]))
    return shown(both, lamp) + shown(both, sky)
