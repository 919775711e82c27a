"""Where light meets geometry: the transport of a scene, the matrix everything else is made from.

    T[x, k] = mean over the footprint of sample x of the integral over texel k of V(x, w) max(0, n . w) dw

so that E(x) = sum over k of T[x, k] L[k]; without occluders its rows sum to pi. Albedo, camera, mask and
reference are not part of it: one transport serves every photograph of a scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.threads import ordered_map
from torchlight.geometry.visibility import OcclusionTest, scene_occlusion
from torchlight.light import cubemap
from torchlight.light.bases import Basis

ALGORITHM = "transport-1"  # part of the cache key: raise it whenever the numbers change
MEMORY_BUDGET = 8 * 2**30  # bytes the transport itself may take
PARTLY = 1e-5  # of a texel: less than one ray of many, more than the rounding of float32 sums
RAYS_PER_BLOCK = 1_000_000  # about 40 MB of rays per thread
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Transfer:
    """The transport of one scene.

    Attributes:
        transport: T, steradians weighted by the cosine; columns in the order of `cubemap.visible_texels`.
        resolution: texels along a cube map face's edge.
    """

    transport: Float[Tensor, "points texels"]
    resolution: int

    def __post_init__(self) -> None:
        texels = cubemap.texel_count(self.resolution)
        if self.transport.shape[1] != texels:
            raise ShapeError(
                f"transport: resolution {self.resolution} has {texels} visible texels, got {self.transport.shape[1]}"
            )

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Transfer:
        """Returns the same transport on another device or in another precision."""
        return replace(self, transport=self.transport.to(device=device, dtype=dtype))

    def mv(self, radiance: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch points"]:
        """Returns the irradiance E of every sample under texel radiance L: E = T L."""
        return radiance @ self.transport.T

    def rmv(self, samples: Float[Tensor, "*batch points"]) -> Float[Tensor, "*batch texels"]:
        """Returns the adjoint T' applied to one value per sample."""
        return samples @ self.transport

    def project(self, basis: Basis) -> Float[Tensor, "points coeffs"]:
        """Returns the transport of a basis: column i is the irradiance under basis function i alone."""
        if basis.resolution != self.resolution:
            raise ShapeError(f"basis resolution {basis.resolution} differs from the transport's {self.resolution}")
        return basis.project(self.transport)


def transport(scene: Scene, resolution: int, subsamples: int, progress: Progress | None = None) -> Transfer:
    """Returns the transport of a scene by ray casting, float32.

    Every texel is cut into subsamples x subsamples cells with exact cosine weights, one direction per cell; the ray
    of the i-th cell starts at the i-th of as many strata of the sample's footprint, so that one sum integrates over
    the texel and over the footprint at once (`footprint_offsets`).

    Args:
        scene: occluders and receiver.
        resolution: texels along a face's edge, a power of two up to 128.
        subsamples: cells along a texel's edge.
        progress: called with (texels done, texels).

    Raises:
        ConfigError: the transport would exceed `MEMORY_BUDGET`, or there is no direction per texel.
    """
    if subsamples < 1:
        raise ConfigError(f"subsamples: expected at least 1 direction along a texel's edge, got {subsamples}")
    texels = cubemap.texel_count(resolution)
    check_budget(scene.receiver.points, texels)
    cells = cubemap.texel_cells(resolution, subsamples)
    directions = cubemap.cell_directions(cells).numpy()
    weights = cubemap.cell_cosine_weights(cells).float()
    offsets = footprint_offsets(texels, subsamples, scene.receiver).numpy()
    points = receiver_points(scene.receiver)
    test = scene_occlusion(scene)
    result = torch.empty(texels, len(points), dtype=torch.float32)

    def fill(block: tuple[slice, slice]) -> int:
        part, rows = block
        hidden = hidden_cells(test, points[rows], directions[part], offsets[part])
        result[part, rows] = torch.einsum("tc,tcp->tp", weights[part], 1.0 - hidden.float())
        return hidden.shape[0] * hidden.shape[2]

    done = 0
    for filled in ordered_map(fill, work_blocks(texels, len(points), subsamples**2)):
        done += filled
        if progress is not None:
            progress(done, texels * len(points))
    return Transfer(result.T.contiguous(), resolution)


def refine(scene: Scene, coarse: Transfer, subsamples: int, progress: Progress | None = None) -> Transfer:
    """Returns the transport with every partly hidden (sample, texel) pair cast anew, subsamples^2 rays each.

    A pair that all coarse rays passed, or none, keeps its value. Shadow edges are where the error is, and they cross
    few pairs (5 to 8 % under a block at 16 texels), so that many more rays there cost little.

    Args:
        scene: the scene that `coarse` was made of.
        coarse: from `transport`.
        subsamples: cells along a texel's edge, more than `coarse` was made with.
        progress: called with (texels done, texels).
    """
    cells = cubemap.texel_cells(coarse.resolution, subsamples)
    directions = cubemap.cell_directions(cells).numpy()
    weights = cubemap.cell_cosine_weights(cells).float()
    offsets = footprint_offsets(len(directions), subsamples, scene.receiver).numpy()
    points = receiver_points(scene.receiver)
    test = scene_occlusion(scene)
    result = coarse.transport.clone()

    def cast(pair: tuple[int, Tensor]) -> tuple[int, Tensor, Tensor]:
        texel, samples = pair
        part = slice(texel, texel + 1)
        hidden = hidden_cells(test, points[samples.numpy()], directions[part], offsets[part])
        return texel, samples, torch.einsum("tc,tcp->tp", weights[part], 1.0 - hidden.float())[0]

    for texel, samples, values in ordered_map(cast, partly_hidden(coarse, RAYS_PER_BLOCK // subsamples**2)):
        result[samples, texel] = values
        if progress is not None:
            progress(texel + 1, len(directions))
    return replace(coarse, transport=result)


def partly_hidden(coarse: Transfer, most: int) -> Iterator[tuple[int, Tensor]]:
    """Yields (texel, samples): the samples from which a texel is partly hidden, at most `most` (or one) at a time."""
    open_sky = cubemap.cosine_weights(coarse.resolution, 1)[:, 0].to(coarse.transport)
    for texel, whole in enumerate(open_sky):
        column = coarse.transport[:, texel]
        partly = (column > whole * PARTLY) & (column < whole * (1 - PARTLY))
        yield from ((texel, samples) for samples in partly.nonzero()[:, 0].split(max(1, most)) if len(samples))


def check_budget(points: int, texels: int) -> None:
    """Raises ConfigError when a float32 transport of this size would exceed the memory budget."""
    size = 4 * points * texels * 2  # the result and its transpose exist together for a moment
    if size > MEMORY_BUDGET:
        raise ConfigError(
            f"the transport of {points:,} samples x {texels:,} texels needs {size / 2**30:.1f} GiB, more than "
            f"{MEMORY_BUDGET / 2**30:.0f} GiB; use fewer receiver.samples or a smaller --resolution"
        )


def receiver_points(receiver: Receiver) -> np.ndarray:
    """Returns the sample centres as world points on z = 0, [points, 3]."""
    centers = sample_centers(receiver)
    return torch.cat([centers, torch.zeros_like(centers[:, :1])], dim=1).numpy()


def hidden_cells(test: OcclusionTest, points: np.ndarray, directions: np.ndarray, offsets: np.ndarray) -> Tensor:
    """Returns whether each point is hidden from each cell's direction, [texels, cells, points]."""
    texels, cells = directions.shape[:2]
    hidden = test.hidden_on_plane(points, directions.reshape(-1, 3), offsets.reshape(-1, 2))
    return torch.from_numpy(hidden).reshape(texels, cells, len(points))


def footprint_offsets(texels: int, subsamples: int, receiver: Receiver) -> Float[Tensor, "texels cells 2"]:
    """Returns the shift of the ray origins for every cell, in the scene's unit.

    Cell (i, j) of a texel is paired with the stratum (a i + b j, c i + d j) mod s of the footprint, a bijection that
    sends neighbouring directions to distant origins; each texel adds its own rotation of the pattern (Cranley and
    Patterson 1976) by a rank-1 lattice, so that the error of one texel is not repeated in the next.
    """
    s = subsamples
    i, j = torch.meshgrid(torch.arange(s), torch.arange(s), indexing="ij")
    step = coprime_near(s, 0.382 * s)
    strata = torch.stack([(j + step * i) % s, (i + step * j + step * step * i) % s], dim=-1).reshape(1, -1, 2)
    lattice = torch.tensor([0.7548776662466927, 0.5698402909980532], dtype=torch.float64)
    turn = torch.arange(texels, dtype=torch.float64)[:, None, None] * lattice
    unit = (strata.double() + turn * s) / s % 1.0
    return (unit - 0.5) * torch.tensor(receiver.footprint, dtype=torch.float64)


def coprime_near(modulus: int, value: float) -> int:
    """Returns the integer in [1, modulus] coprime to the modulus that lies nearest to a value."""
    candidates = [k for k in range(1, modulus + 1) if np.gcd(k, modulus) == 1]
    return min(candidates, key=lambda k: abs(k - value))


def work_blocks(texels: int, points: int, cells: int) -> Iterator[tuple[slice, slice]]:
    """Yields (texels, points) blocks of at most about RAYS_PER_BLOCK rays."""
    rows = max(1, min(points, RAYS_PER_BLOCK // cells))
    count = max(1, RAYS_PER_BLOCK // (cells * rows))
    for start in range(0, texels, count):
        for first in range(0, points, rows):
            yield slice(start, min(start + count, texels)), slice(first, min(first + rows, points))
