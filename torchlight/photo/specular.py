"""Which samples show a glint: light that the plane mirrors, which no diffuse plane can show.

A diffuse plane is nowhere brighter than where it lies in no shadow. Under distant light, fall-off divided out, that
level is one number; here the largest local median. What is brighter by far in a small patch is a mirror image of a lamp
in gloss, a drop, a grain of metal. Glints in shadow are not found: they are for the robust loss.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.photo.observation import Observation, Rejection

REACH = 4  # samples: a window of 9 x 9, whose median a glint of fewer than 40 samples leaves alone
FEWEST = 40  # used samples of a window that has a median: half of it
SURE, SEEN = 6.0, 2.5  # deviations above the level: at its brightest, and out to where it ends
LEAST_DEVIATION = 0.004  # of the level: half a step of 8-bit sRGB at white


def without_glints(observation: Observation, samples: tuple[int, int]) -> Observation:
    """Returns the observation with the weight 0 where `glints` are, which `rejected` then says.

    Args:
        observation: samples and weights, fall-off and albedo divided out.
        samples: the receiver's columns and rows.
    """
    found = glints(observation, samples)
    return observation.without(found, Rejection.SPECULAR) if bool(found.any()) else observation


def glints(observation: Observation, samples: tuple[int, int]) -> Bool[Tensor, "*batch points"]:
    """Returns the samples of small patches that are brighter than the unshadowed plane, and those next to them.

    Brightness is the mean over channels, in ln. The level is the largest median of 9 x 9 samples, the noise 1.4826
    times the median distance from the local median, at least 0.4 %. A patch is joined where it is 2.5 deviations above
    the level, is brighter by 6 in at least one sample, spans at most 9 samples in x and in y, and does not touch the
    receiver's rim. So a bright seam along a shadow (sharpening, tone mapping) and a near lamp's hot spot are kept:
    they are no glints.

    Args:
        observation: samples and weights.
        samples: the receiver's columns and rows.
    """
    columns, rows = samples
    grey = observation.samples.mean(dim=-2).reshape(-1, rows, columns).double()
    used = (observation.weights > 0).reshape(-1, rows, columns) & (grey > 0)
    level = torch.where(used, grey.clamp(min=1e-30).log(), torch.nan)
    found = [_glints(item) for item in level.cpu()]
    shaped = torch.stack(found).reshape(observation.weights.shape).to(observation.weights.device)
    return shaped & (observation.weights > 0)


def _glints(image: Float[Tensor, "rows columns"]) -> Bool[Tensor, "rows columns"]:
    nothing = torch.zeros_like(image, dtype=torch.bool)
    middle = local_median(image)
    if not bool(middle.isfinite().any()):
        return nothing
    deviation = max(1.4826 * (image - middle).abs().nanmedian().item(), LEAST_DEVIATION)
    above = (image - middle[middle.isfinite()].max()) / deviation
    if not bool((above > SURE).any()):
        return nothing
    return torch.from_numpy(_small_patches((above > SEEN).numpy(), (above > SURE).numpy()))


def local_median(image: Float[Tensor, "rows columns"]) -> Float[Tensor, "rows columns"]:
    """Returns the median of each sample's 9 x 9 neighbourhood; NaN where fewer than 40 samples of it are known."""
    around = torch.nn.functional.pad(image, (REACH,) * 4, value=torch.nan)
    side = 2 * REACH + 1
    windows = around.unfold(0, side, 1).unfold(1, side, 1).flatten(start_dim=2)
    known = windows.isfinite().sum(dim=-1)
    return torch.where(known >= FEWEST, windows.nanmedian(dim=-1).values, torch.nan)


def _small_patches(bright: NDArray[np.bool_], sure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns the connected patches of `bright` that are small, hold a `sure` sample and lie off the rim; grown by one.

    Connected by sides and corners.
    """
    rows, columns = bright.shape
    count, label, stats, _ = cv2.connectedComponentsWithStats(bright.astype(np.uint8), connectivity=8)
    left, top, width, height = stats[:, : cv2.CC_STAT_HEIGHT + 1].T
    small = np.maximum(width, height) <= 2 * REACH + 1
    inner = (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    holds = np.bincount(label[sure], minlength=count) > 0
    chosen = small & inner & holds
    chosen[0] = False  # what is not bright
    return cv2.dilate(chosen[label].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
