"""A measured photograph under a near light: a wall lit by a screen a metre away, behind a little chair.

Saunders, Murray-Bruce and Goyal, Nature 565 (2019), 472: linear sensor sums of a white wall at y = 1.03 m, x from 0.543
to 0.944 m and z from 0.064 to 0.465 m; a screen at y = 0; the chair's seat, back and legs as published with them. Here
the wall is the receiver: (x, z, 1.03 - y). The first column of the photograph is the largest x and its first row the
largest z.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch
from realdata import data_path
from torch import Tensor

from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.near_light.verdict import near_light
from torchlight.photo.observation import Observation

WALL, CORNER, SIDE, THIN = 1.03, (0.506, 0.594, 0.242), 0.075, 0.004  # m
LEG = 0.015
SAMPLES = 63


def slab(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Tensor:
    """Returns the block between world coordinates, in the wall's frame."""
    low = torch.tensor([x[0], z[0], WALL - y[1]], dtype=torch.float64)
    high = torch.tensor([x[1], z[1], WALL - y[0]], dtype=torch.float64)
    size = (high - low).tolist()
    middle = (low + high) / 2
    return box((size[0], size[1], size[2])) + torch.stack([middle[0], middle[1], low[2]])


def chair() -> Tensor:
    """Returns seat, back, four legs and the bar between the front ones."""
    x, y, z = CORNER
    across, deep = (x, x + SIDE), (y, y + SIDE)
    parts = [slab(across, deep, (z - THIN, z)), slab(across, (y + SIDE - THIN, y + SIDE), (z, z + SIDE))]
    for left in (x, x + SIDE - LEG):
        for front in (y, y + SIDE - THIN):
            parts.append(slab((left, left + LEG), (front, front + THIN), (0.0, z - THIN)))
    parts.append(slab(across, (y, y + THIN), (z - 0.075, z - 0.06)))
    return torch.cat(parts)


def test_the_screen_is_reported_as_near() -> None:
    from scipy.io import loadmat

    path = data_path("photos", "periscopy_chair", "chair_test.mat")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scipy on a variable without a name
        stored = loadmat(path, variable_names=["test_image1"])["test_image1"]
    image = torch.from_numpy(np.ascontiguousarray(stored[::-1, ::-1]).astype(np.float64)).permute(2, 0, 1)
    values = torch.nn.functional.avg_pool2d(image, 2) / image.max()
    receiver = Receiver((0.7435, 0.2645), (0.401, 0.401), (SAMPLES, SAMPLES))
    observation = Observation(values.reshape(3, -1), torch.ones(receiver.points, dtype=torch.float64))
    verdict = near_light(Scene(chair(), receiver), observation)
    assert verdict is not None
    assert verdict.flagged
    assert 15 < verdict.drift_degrees < 45  # of a point of the screen: 20 to 32 degrees over the wall's diagonal
