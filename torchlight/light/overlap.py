"""How cube-map texels and lat-long pixels share the sphere: resampling that keeps energy.

The solid angle that a pixel and a texel have in common is found meridian by meridian. At a fixed azimuth phi every
boundary crosses at a known z = cos theta: pixel rows at z = cos theta_i, the row v = c of a side face at
z = c a / sqrt(1 + c^2 a^2) with a = max(|cos phi|, |sin phi|), the lines x / z = c and y / z = c of the top face at
z = 1 / sqrt(1 + (c / cos phi)^2) and 1 / sqrt(1 + (c / sin phi)^2). Between two crossings the pixel and the texel
are constant, so the integral over z is exact, and so is every pixel's total. In phi, strips between all pixel
columns, texel columns and texel corners of the top face are integrated by Gauss's rule: within a strip the crossings
are smooth, and every texel's total is right to 1e-6. (Above 128 texels per edge, which only cube crosses have, narrow
strips stand in for the corners; see STRIPS_PER_TEXEL.) Strips of constant latitude would meet the texel rows
tangentially and converge as their width^1.5 only. The rest follows from a quarter of the upper hemisphere by symmetry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light import cubemap, latlong

MINIMUM_STRIPS = 512  # at most 0.7 degrees wide: the two-point rule then leaves 1e-8
NARROW = 2e-4  # radians; in narrower strips one node leaves 1e-6
MAXIMUM_CORNER_RESOLUTION = 128  # beyond, the 0.6 N^2 corner azimuths cost too much: narrow strips replace them,
STRIPS_PER_TEXEL = 32  # which leave a texel of the top face 3e-2 off at worst, 1e-3 typically
CHUNK = 1_000_000  # crossings at once: about 300 MB
_ONE_AT_A_TIME = Lock()
Move = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]


@dataclass(frozen=True, eq=False)
class Overlap:
    """Solid angles shared by lat-long pixels and texels; every pair that meets appears once.

    Attributes:
        pixels: row * width + column of the lat-long image.
        texels: index in the texel vector.
        areas: shared solid angle, in steradians.
        height: rows of the lat-long image.
        texel_count: length of the texel vector.
    """

    pixels: Int[Tensor, " pairs"]
    texels: Int[Tensor, " pairs"]
    areas: Float[Tensor, " pairs"]
    height: int
    texel_count: int


def texels_to_latlong(
    values: Float[Tensor, "*batch texels"], resolution: int, height: int
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns the lat-long image whose pixels are area averages of a plane's visible texels, 0 below the horizon."""
    if values.shape[-1] != cubemap.texel_count(resolution):
        raise ShapeError(
            f"texels_to_latlong: resolution {resolution} has {cubemap.texel_count(resolution)} visible texels, "
            f"got {values.shape[-1]}; pass the resolution the values were made for"
        )
    return _average_to_pixels(plane_overlap(resolution, height), values)


def latlong_to_texels(
    radiance: Float[Tensor, "*batch height width"], resolution: int
) -> Float[Tensor, "*batch texels"]:
    """Returns the area average of a lat-long image over the part above the horizon of each visible texel."""
    latlong.check_latlong(radiance.shape[-2], radiance.shape[-1])
    return _average_to_texels(plane_overlap(resolution, radiance.shape[-2]), radiance)


def cubemap_to_latlong(
    faces: Float[Tensor, "*batch 6 resolution resolution"], height: int
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns the lat-long image whose pixels are area averages of a six-face cube map."""
    return _average_to_pixels(sphere_overlap(faces.shape[-1], height), faces.flatten(start_dim=-3))


def latlong_to_cubemap(
    radiance: Float[Tensor, "*batch height width"], resolution: int
) -> Float[Tensor, "*batch 6 {resolution} {resolution}"]:
    """Returns the six-face cube map whose texels are area averages of a lat-long image."""
    latlong.check_latlong(radiance.shape[-2], radiance.shape[-1])
    values = _average_to_texels(sphere_overlap(resolution, radiance.shape[-2]), radiance)
    return values.unflatten(-1, (6, resolution, resolution))


def plane_overlap(resolution: int, height: int) -> Overlap:
    """Returns the overlap of a lat-long image with a plane's visible texels, in float64 on the CPU.

    The last few are kept, since every photograph of a batch is written at the same size; where one thread is at work
    on it, others wait.
    """
    with _ONE_AT_A_TIME:
        return _plane_overlap(resolution, height)


@lru_cache(maxsize=4)
def _plane_overlap(resolution: int, height: int) -> Overlap:
    key, area = _upper_overlap(resolution, height)
    texels = 6 * resolution**2
    visible = cubemap.visible_texels(resolution)
    compact = torch.full((texels,), -1, dtype=torch.long).index_put((visible,), torch.arange(len(visible)))
    return Overlap(key // texels, compact[key % texels], area, height, len(visible))


def sphere_overlap(resolution: int, height: int) -> Overlap:
    """Returns the overlap of a lat-long image with all six faces, in float64 on the CPU."""
    key, area = _upper_overlap(resolution, height)
    texels = 6 * resolution**2
    key, area = _sum_by_key(torch.cat([key, _mirror(key, resolution, height)]), area.repeat(2))
    return Overlap(key // texels, key % texels, area, height, texels)


# --- averages ------------------------------------------------------------------------------------------------------


def _average_to_pixels(
    overlap: Overlap, values: Float[Tensor, "*batch texels"]
) -> Float[Tensor, "*batch rows columns"]:
    height = overlap.height
    area = latlong.row_solid_angles(height)[overlap.pixels // (2 * height)]
    image = _gather(overlap.pixels, overlap.texels, overlap.areas / area, 2 * height**2, values)
    return image.unflatten(-1, (height, 2 * height))


def _average_to_texels(
    overlap: Overlap, radiance: Float[Tensor, "*batch rows columns"]
) -> Float[Tensor, "*batch texels"]:
    area = overlap.areas.new_zeros(overlap.texel_count).index_add(0, overlap.texels, overlap.areas)
    weights = overlap.areas / area[overlap.texels]
    return _gather(overlap.texels, overlap.pixels, weights, overlap.texel_count, radiance.flatten(start_dim=-2))


def _gather(
    targets: Int[Tensor, " pairs"],
    sources: Int[Tensor, " pairs"],
    weights: Float[Tensor, " pairs"],
    size: int,
    values: Float[Tensor, "*batch sources"],
) -> Float[Tensor, "*batch {size}"]:
    """Returns out[..., target] = sum of weight * values[..., source] over the pairs."""
    matrix = torch.sparse_coo_tensor(
        torch.stack([targets, sources]), weights, (size, values.shape[-1]), check_invariants=False
    ).to(values)
    flat = values.reshape(-1, values.shape[-1])
    return torch.sparse.mm(matrix, flat.T).T.reshape(*values.shape[:-1], size)


# --- the shared solid angles -----------------------------------------------------------------------------------------


def _upper_overlap(resolution: int, height: int) -> tuple[Int[Tensor, " pairs"], Float[Tensor, " pairs"]]:
    """Returns pixel * texels + texel (six-face index) and the solid angle shared above the horizon."""
    if resolution < 1 or height < 1:
        raise ShapeError(f"overlap: expected positive sizes, got resolution {resolution} and height {height}")
    azimuths, widths = _meridians(resolution, height)
    symmetric = height % 2 == 0  # then a quarter turn is a whole number of columns, and half of it two mirror images
    if symmetric:
        first = (azimuths > 0) & (azimuths < math.pi / 4)
        azimuths, widths = azimuths[first], widths[first]
    step = max(1, CHUNK // (height // 2 + 2 * resolution))
    parts = [
        _chunk(azimuths[start : start + step], widths[start : start + step], resolution, height)
        for start in range(0, len(azimuths), step)
    ]
    key, area = _sum_by_key(torch.cat([key for key, _ in parts]), torch.cat([area for _, area in parts]))
    if not symmetric:
        return key, area
    mirror = _image(resolution, lambda x, y, z: (y, x, z))
    mirrored = _moved(key, mirror, lambda column: 3 * height // 2 - 1 - column, height)
    key, area = _sum_by_key(torch.cat([key, mirrored]), area.repeat(2))  # a column in the middle is its own image
    # each quarter turn meets columns of its own, so that the four sets of pairs are disjoint; azimuth grows leftwards
    turn, keys = _image(resolution, lambda x, y, z: (-y, x, z)), [key]
    for _ in range(3):
        keys.append(_moved(keys[-1], turn, lambda column: column - height // 2, height))
    return torch.cat(keys), area.repeat(4)


def _image(resolution: int, move: Move) -> Int[Tensor, " texels"]:
    """Returns for each texel of the six faces where a symmetry of the cube, given for x, y and z, takes it."""
    return cubemap.texel_index(torch.stack(move(*cubemap.texel_directions(resolution).unbind(-1)), -1), resolution)


def _moved(
    key: Int[Tensor, " pairs"], image: Int[Tensor, " texels"], columns: Callable[[Tensor], Tensor], height: int
) -> Int[Tensor, " pairs"]:
    """Returns where a symmetry that keeps heights takes each pair.

    Args:
        key: pixel * texels + texel.
        image: of the texels.
        columns: where it takes pixel columns, up to whole turns.
        height: rows of the lat-long image.
    """
    pixel, texel = key // len(image), key % len(image)
    row, column = pixel // (2 * height), pixel % (2 * height)
    return (row * (2 * height) + torch.remainder(columns(column), 2 * height)) * len(image) + image[texel]


def _mirror(key: Int[Tensor, " pairs"], resolution: int, height: int) -> Int[Tensor, " pairs"]:
    """Returns the pair at the mirrored place z -> -z."""
    mirrored = _image(resolution, lambda x, y, z: (x, y, -z))
    pixel, texel = key // len(mirrored), key % len(mirrored)
    row, column = pixel // (2 * height), pixel % (2 * height)
    return ((height - 1 - row) * (2 * height) + column) * len(mirrored) + mirrored[texel]


def _meridians(resolution: int, height: int) -> tuple[Float[Tensor, " nodes"], Float[Tensor, " nodes"]]:
    """Returns azimuths in (-pi, pi) and weights that sum to 2 pi."""
    corners = resolution <= MAXIMUM_CORNER_RESOLUTION
    strips = MINIMUM_STRIPS if corners else STRIPS_PER_TEXEL * resolution
    lines = torch.linspace(-1, 1, resolution + 1, dtype=torch.float64)
    columns = torch.atan(lines) + torch.arange(-1, 3, dtype=torch.float64)[:, None] * (math.pi / 2)
    edges = [
        latlong.column_boundaries(2 * height * math.ceil(strips / (2 * height))),
        torch.remainder(columns.reshape(-1) + math.pi, 2 * math.pi) - math.pi,
        torch.atan2(lines[:, None], lines).reshape(-1) if corners else lines[:0],
    ]
    edge = torch.cat(edges).sort().values
    edge = torch.cat([edge[:1], edge[1:][edge.diff() > 1e-12]])
    middle, half = (edge[1:] + edge[:-1]) / 2, edge.diff() / 2
    wide = 2 * half > NARROW
    offset = half[wide] / math.sqrt(3)
    azimuths = torch.cat([middle[~wide], middle[wide] - offset, middle[wide] + offset])
    weights = torch.cat([2 * half[~wide], half[wide], half[wide]])
    order = azimuths.argsort()
    return azimuths[order], weights[order]


def _chunk(
    azimuths: Float[Tensor, " nodes"], widths: Float[Tensor, " nodes"], resolution: int, height: int
) -> tuple[Int[Tensor, " pairs"], Float[Tensor, " pairs"]]:
    """Returns pixel * texels + texel and the shared solid angle of each pair met on some meridians."""
    z = _crossings(azimuths, resolution, height)
    length, middle = z.diff(dim=1), (z[:, 1:] + z[:, :-1]) / 2
    row = (torch.acos(middle) * (height / math.pi)).long().clamp_(0, height - 1)
    column = ((math.pi - azimuths) * (height / math.pi)).long().clamp(0, 2 * height - 1)
    key = (row * (2 * height) + column[:, None]) * (6 * resolution**2) + _texels_met(azimuths, middle, resolution)
    met = length > 1e-14
    return _sum_by_key(key[met], (length * widths[:, None])[met])


def _texels_met(
    azimuths: Float[Tensor, " nodes"], z: Float[Tensor, "nodes heights"], resolution: int
) -> Int[Tensor, "nodes heights"]:
    """Returns what `cubemap.texel_index` says of points of the upper sphere on meridians, whose side face is one."""
    cosine, sine = azimuths.cos()[:, None], azimuths.sin()[:, None]
    horizon = torch.cat([cosine, sine, torch.zeros_like(sine)], dim=1)
    side_bottom = cubemap.texel_index(horizon, resolution)[:, None]  # in the row that holds v = 0
    cotangent = z / (1 - z * z).clamp_(min=0).sqrt_()
    up = cotangent / torch.maximum(cosine.abs(), sine.abs())  # v on the side face; beyond 1 the top one begins
    lower = resolution // 2
    rows = ((1 - up) * (resolution / 2)).long()
    side = side_bottom + (rows - lower).clamp_(-lower, 0) * resolution
    right, down = (1 - sine / cotangent).mul_(resolution / 2), (1 + cosine / cotangent).mul_(resolution / 2)
    last = resolution - 1
    top = (cubemap.TOP_FACE * resolution + down.long().clamp_(0, last)) * resolution + right.long().clamp_(0, last)
    return torch.where(up > 1, top, side)


def _crossings(azimuths: Float[Tensor, " nodes"], resolution: int, height: int) -> Float[Tensor, "nodes crossings"]:
    """Returns, for each meridian in ascending order, every z >= 0 at which the pixel or the texel can change.

    Lines of a face are continued beyond it; the surplus crossings only cut an interval in two.
    """
    lines = torch.linspace(-1, 1, resolution + 1, dtype=torch.float64)
    lines = lines[lines > 1e-9]
    cosine, sine = azimuths.cos().abs()[:, None], azimuths.sin().abs()[:, None]
    slope = lines * torch.maximum(cosine, sine)
    sides = slope / torch.sqrt(1 + slope * slope)
    top = [side / torch.sqrt(side * side + lines * lines) for side in (cosine, sine)]
    rows = torch.cos(latlong.row_boundaries(height))[: height // 2 + 1].expand(len(azimuths), -1)
    horizon = torch.zeros_like(cosine)
    return torch.cat([rows, sides, *top, horizon], dim=1).sort(dim=1).values


def _sum_by_key(
    key: Int[Tensor, " entries"], area: Float[Tensor, " entries"]
) -> tuple[Int[Tensor, " pairs"], Float[Tensor, " pairs"]]:
    """Returns the distinct keys in ascending order and the sum of the areas of each."""
    distinct, position = torch.unique(key, return_inverse=True)
    return distinct, area.new_zeros(len(distinct)).index_add(0, position, area)
