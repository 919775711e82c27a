"""From the photograph's pixels to the receiver's samples: every sample averages the pixels of its own footprint."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.photo.observation import LinearPhoto, Observation

SUBPOINTS_PER_CALL = 2_000_000


def from_camera(
    photo: LinearPhoto, pixels: Float[Tensor, "points sub 2"], visible: Bool[Tensor, " points"]
) -> Observation:
    """Returns the mean of the photograph over each sample's footprint.

    Args:
        photo: linear photographs of one camera.
        pixels: where the photograph shows the points of each footprint (x, y; centres at integers; bilinear).
        visible: samples that geometry lets the camera see.
    """
    lead = photo.radiance.shape[:-3]
    radiance = photo.radiance.reshape(-1, *photo.radiance.shape[-3:])
    usable = photo.usable.reshape(-1, 1, *photo.usable.shape[-2:])
    layers = torch.cat([torch.where(usable, radiance, torch.zeros_like(radiance)), (~usable).to(radiance)], dim=1)
    step = max(1, SUBPOINTS_PER_CALL // (pixels.shape[1] * len(layers)))
    parts = [_footprint_means(layers, part) for part in pixels.to(radiance).split(step)]
    means = torch.cat(parts, dim=-1)
    weights = (means[:, 3] == 0) & visible.to(means.device)
    return _observation(means[:, :3], weights, lead)


def _footprint_means(
    layers: Float[Tensor, "batch layers height width"], pixels: Float[Tensor, "points sub 2"]
) -> Float[Tensor, "batch layers points"]:
    from kornia.geometry.transform import remap

    maps = pixels.nan_to_num(nan=-1e6).expand(len(layers), -1, -1, -1)
    # align_corners must be given: kornia's default reads half a pixel off
    values = remap(layers, maps[..., 0], maps[..., 1], mode="bilinear", padding_mode="border", align_corners=True)
    return values.mean(dim=-1)


def from_rectified(photo: LinearPhoto, samples: tuple[int, int], visible: Bool[Tensor, " points"]) -> Observation:
    """Returns the exact area average of a rectified receiver image over each sample.

    Args:
        photo: images of the whole receiver, row 0 at its largest y, of any size.
        samples: the receiver's columns and rows.
        visible: samples on which no occluder stands.
    """
    lead = photo.radiance.shape[:-3]
    usable = photo.usable[..., None, :, :]
    clean = torch.where(usable, photo.radiance, torch.zeros_like(photo.radiance))
    means = area_average(clean, samples).flatten(start_dim=-2)
    spoiled = area_average((~usable).to(clean), samples).flatten(start_dim=-2)[..., 0, :]
    weights = (spoiled == 0) & visible.to(means.device)
    return _observation(means.reshape(-1, *means.shape[-2:]), weights.reshape(-1, weights.shape[-1]), lead)


def area_average(
    image: Float[Tensor, "*batch height width"], samples: tuple[int, int]
) -> Float[Tensor, "*batch rows columns"]:
    """Returns the area average of an image over columns x rows equal rectangles, row 0 at the bottom of the image."""
    columns, rows = samples
    across = cell_overlap(image.shape[-1], columns).to(image)
    down = cell_overlap(image.shape[-2], rows).to(image).flip(0)
    return down @ image @ across.T


def cell_overlap(cells: int, parts: int) -> Float[Tensor, "parts cells"]:
    """Returns which share of each of `parts` equal intervals lies in each of `cells` equal ones of the same line."""
    ends = torch.arange(parts + 1, dtype=torch.float64) / parts * cells
    start = torch.arange(cells, dtype=torch.float64)
    overlap = torch.minimum(ends[1:, None], start + 1) - torch.maximum(ends[:-1, None], start)
    overlap = overlap.clamp(min=0)
    overlap[overlap < 1e-9] = 0  # rounding of the ends must not spoil a neighbour's sample
    return overlap / overlap.sum(dim=1, keepdim=True)


def _observation(
    means: Float[Tensor, "batch 3 points"], weights: Bool[Tensor, "batch points"], lead: torch.Size
) -> Observation:
    samples = torch.where(weights[:, None], means, torch.zeros_like(means))
    return Observation(samples.reshape(*lead, *means.shape[1:]), weights.to(means).reshape(*lead, means.shape[-1]))
