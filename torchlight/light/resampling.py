"""Radiance moved from one grid to another so that no light is lost, on the whole or anywhere.

Radiance is constant over each pixel. With A_st the solid angle that source pixel s and target pixel t have in common,

    L_t = sum over s of A_st L_s / A_t,

the mean of the source over the target pixel. Where sum over t of A_st = A_s, each source pixel's flux L_s A_s arrives,
be it a sun of a single pixel; where sum over s of A_st = A_t, a constant stays a constant. Lat-longs are resized with
exact A_st (rows and columns part), and a cube map meets a lat-long along meridians (`overlap`). All else, rotations
too, is counted: directions spread over each pixel of both grids say which pixels meet. The counts are then balanced
until their sums over t and over s are the exact solid angles (over-relaxed iterative proportional fitting), so that
both properties hold whatever was counted. The last step makes the flux of every source pixel exact; a constant is kept
as well as the rounds allow: to 2e-4 at 64 rows, 2e-3 at 256, of angular maps to 4e-3 and 2e-2 (mean square 1e-3).

References:
    Deming and Stephan, On a least squares adjustment of a sampled frequency table (1940). Thibault et al.,
    Overrelaxed Sinkhorn-Knopp algorithm for regularized optimal transport (2017).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light.grids import CubeGrid, Grid, LatlongGrid
from torchlight.light.overlap import sphere_overlap
from torchlight.light.rotations import is_about_z

MINIMUM_PARTS, MAXIMUM_PARTS = 4, 16  # along each side of a pixel
DIRECTIONS = 1 << 20  # spread over a grid, if the parts allow
DIRECTIONS_AT_ONCE = 1 << 20
MOST_PIXELS = 32_000_000  # of both grids, where pairs are counted: some 10 GB
BALANCED = 1e-9
MAXIMUM_ROUNDS = 40
RELAXATION = 1.6  # 40 rounds then do what some 300 plain ones do
TOUCHING = 1e-9  # of a pixel: edges as near as that are the same
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Shared:
    """Solid angles that source and target pixels have in common; every pair appears once.

    Attributes:
        sources: pixel of the source grid.
        targets: pixel of the target grid.
        angles: in steradians.
    """

    sources: Int[Tensor, " pairs"]
    targets: Int[Tensor, " pairs"]
    angles: Float[Tensor, " pairs"]


def resample(
    values: Float[Tensor, "*batch source_pixels"],
    source: Grid,
    target: Grid,
    rotation: Float[Tensor, "3 3"] | None = None,
    progress: Progress | None = None,
) -> Float[Tensor, "*batch target_pixels"]:
    """Returns radiance on another grid, turned on the way: what came from d then comes from rotation @ d.

    Args:
        values: radiance per pixel of the source, flat.
        source: their grid.
        target: the grid wanted.
        rotation: None = not turned.
        progress: called with (done, total).

    Raises:
        ShapeError: another number of values.
        ConfigError: too many pixels to be counted.
    """
    if values.shape[-1] != math.prod(source.shape):
        raise ShapeError(f"resample: expected {math.prod(source.shape)} pixels of {source}, got {values.shape[-1]}")
    upright = rotation is None or is_about_z(rotation)
    if isinstance(source, LatlongGrid) and isinstance(target, LatlongGrid) and upright:
        azimuth = 0.0 if rotation is None else math.atan2(rotation[1, 0].item(), rotation[0, 0].item())
        return _resized(values.unflatten(-1, source.shape), target.height, azimuth).flatten(start_dim=-2)
    if rotation is None and source == target:
        return values
    return _moved(values, shared_angles(source, target, rotation, progress), target)


def shared_angles(
    source: Grid, target: Grid, rotation: Float[Tensor, "3 3"] | None = None, progress: Progress | None = None
) -> Shared:
    """Returns which pixels of two grids meet, the source turned by `rotation`, balanced."""
    if rotation is None and isinstance(source, CubeGrid) and isinstance(target, LatlongGrid):
        met = sphere_overlap(source.resolution, target.height)
        pairs = Shared(met.texels, met.pixels, met.areas)
    elif rotation is None and isinstance(source, LatlongGrid) and isinstance(target, CubeGrid):
        met = sphere_overlap(target.resolution, source.height)
        pairs = Shared(met.pixels, met.texels, met.areas)
    else:
        turn = torch.eye(3, dtype=torch.float64) if rotation is None else rotation.double().cpu()
        pairs = _counted(source, target, turn, progress)
    return _balanced(pairs, source.solid_angles(), target.solid_angles())


def _moved(
    values: Float[Tensor, "*batch source_pixels"], shared: Shared, target: Grid
) -> Float[Tensor, "*batch target_pixels"]:
    areas = target.solid_angles()
    size = (len(areas), values.shape[-1])
    indices = torch.stack([shared.targets, shared.sources])
    matrix = torch.sparse_coo_tensor(indices, shared.angles / areas[shared.targets], size, check_invariants=False)
    flat = values.reshape(-1, values.shape[-1]).to(device="cpu", dtype=torch.float64)
    return torch.sparse.mm(matrix, flat.T).T.reshape(*values.shape[:-1], len(areas)).to(values)


# --- counting and balancing ----------------------------------------------------------------------------------------


def _counted(source: Grid, target: Grid, turn: Float[Tensor, "3 3"], progress: Progress | None) -> Shared:
    """Returns about how much the pixels of two grids share, from directions spread over the pixels of both.

    Pixels of either grid may be the smaller ones anywhere, and the smaller ones find what they meet.
    """
    total = math.prod(source.shape) + math.prod(target.shape)
    if total > MOST_PIXELS:
        raise ConfigError(
            f"resample: {source} and {target} have {total:,} pixels together, more than {MOST_PIXELS:,}; "
            "choose a smaller size, or resize a lat-long before it is turned"
        )
    width = math.prod(target.shape)
    keys, angles, done = [], [], 0
    # weights of source and target pixel in the number of a pair
    for own, other, to_other, own_weight, other_weight in (
        (source, target, turn.T, width, 1),
        (target, source, turn, 1, width),
    ):
        count = math.prod(own.shape)
        parts = min(max(math.isqrt(DIRECTIONS // count), MINIMUM_PARTS), MAXIMUM_PARTS)
        for pixels in torch.arange(count).split(DIRECTIONS_AT_ONCE // parts**2):
            directions, weights = own.parts(pixels, parts)
            mine, found = own.owners(pixels)[:, None], other.locate(directions @ to_other)
            key = mine * own_weight + found * other_weight
            key, angle = _sum_by_key(key[weights > 0], weights[weights > 0])
            keys.append(key)
            angles.append(angle)
            done += len(pixels)
            if progress is not None:
                progress(done, total)
    key, angle = _sum_by_key(torch.cat(keys), torch.cat(angles))
    return Shared(key // width, key % width, angle)


def _balanced(shared: Shared, of_source: Float[Tensor, " sources"], of_target: Float[Tensor, " targets"]) -> Shared:
    """Returns the shared angles scaled per source and per target pixel until both sums are the solid angles given."""
    angles = shared.angles
    for _ in range(MAXIMUM_ROUNDS):
        down, across = _factors(angles, shared.targets, of_target), _factors(angles, shared.sources, of_source)
        if max((down - 1).abs().max().item(), (across - 1).abs().max().item()) < BALANCED:
            break
        angles = angles * (down**RELAXATION)[shared.targets]
        angles = angles * (_factors(angles, shared.sources, of_source) ** RELAXATION)[shared.sources]
    angles = angles * _factors(angles, shared.sources, of_source)[shared.sources]
    return Shared(shared.sources, shared.targets, angles)


def _factors(
    angles: Float[Tensor, " pairs"], pixels: Int[Tensor, " pairs"], wanted: Float[Tensor, " pixels"]
) -> Float[Tensor, " pixels"]:
    """Returns by what the angles of each pixel fall short of the sum wanted; 1 where there are none."""
    sums = torch.zeros_like(wanted).index_add(0, pixels, angles)
    return torch.where(sums > 0, wanted / torch.where(sums > 0, sums, 1), 1)


def _sum_by_key(
    key: Int[Tensor, " entries"], angle: Float[Tensor, " entries"]
) -> tuple[Int[Tensor, " pairs"], Float[Tensor, " pairs"]]:
    """Returns the distinct keys in ascending order and the sum of the angles of each."""
    distinct, position = torch.unique(key, return_inverse=True)
    return distinct, angle.new_zeros(len(distinct)).index_add(0, position, angle)


# --- lat-long to lat-long ------------------------------------------------------------------------------------------


def _resized(
    image: Float[Tensor, "*batch rows columns"], height: int, azimuth: float
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns a lat-long of another height turned about z: exact averages, rows weighted by solid angle."""
    rows, columns = image.shape[-2:]
    # Azimuth grows to the left, so the target's column 0 begins further right in the source's picture.
    shift = columns * azimuth / (2 * math.pi)
    whole = math.floor(shift + TOUCHING)
    start = max(shift - whole, 0.0) if shift - whole > TOUCHING else 0.0
    turned = image.double().roll(-whole, dims=-1)
    across = torch.arange(2 * height + 1, dtype=torch.float64) * (columns / (2 * height)) + start
    source, target, width = _intervals(columns + 1, across)
    picked = turned.index_select(-1, (source % columns).to(image.device)) * width.to(image.device)
    wide = _summed(picked, target, 2 * height) / (columns / (2 * height))
    down = torch.arange(height + 1, dtype=torch.float64) * (rows / height)
    source, target, (top, bottom) = _pieces(rows, down)
    step = math.pi / rows
    share = 2 * torch.sin((top + bottom) * (step / 2)) * torch.sin((bottom - top) * (step / 2))
    total = torch.zeros(height, dtype=torch.float64).index_add(0, target, share)
    picked = wide.index_select(-2, source.to(image.device)) * (share / total[target])[:, None].to(image.device)
    return _summed(picked.mT, target, height).mT.to(image.dtype)


def _intervals(
    count: int, edges: Float[Tensor, " edges"]
) -> tuple[Int[Tensor, " pieces"], Int[Tensor, " pieces"], Float[Tensor, " pieces"]]:
    """Returns for each piece of a line cut at 0, 1, .. count and at `edges` its unit, its interval and its length."""
    source, target, (start, end) = _pieces(count, edges)
    return source, target, end - start


def _pieces(
    count: int, edges: Float[Tensor, " edges"]
) -> tuple[Int[Tensor, " pieces"], Int[Tensor, " pieces"], tuple[Float[Tensor, " pieces"], Float[Tensor, " pieces"]]]:
    """Returns for each piece between two cuts its unit, its interval, and where it starts and ends."""
    nearest = edges.round()
    edges = torch.where((edges - nearest).abs() < TOUCHING, nearest, edges)
    units = torch.arange(count + 1, dtype=torch.float64)
    cuts = torch.unique(torch.cat([units[(units > edges[0]) & (units < edges[-1])], edges]))
    start, end = cuts[:-1], cuts[1:]
    middle = (start + end) / 2
    target = torch.searchsorted(edges, middle, right=True) - 1
    return middle.floor().long(), target, (start, end)


def _summed(
    pieces: Float[Tensor, "*batch pieces"], targets: Int[Tensor, " pieces"], count: int
) -> Float[Tensor, "*batch {count}"]:
    """Returns the sum over the pieces of each target."""
    zeros = pieces.new_zeros(*pieces.shape[:-1], count)
    return zeros.index_add(-1, targets.to(pieces.device), pieces)
