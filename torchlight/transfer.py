"""Where light meets geometry: the transport of a scene, the matrix everything else is made from.

    T[x, k] = mean over the footprint of sample x of the integral over texel k of V(x, w) max(0, n . w) dw

so that E(x) = sum over k of T[x, k] L[k]; without occluders its rows sum to pi. Albedo, camera, mask and
reference are not part of it: one transport serves every photograph of a scene.

A texel, or any square of the cube map's faces, is integrated over subsamples x subsamples equal cells with exact
cosine weights, one direction each. Along x the share of a footprint that a direction sees is exact; along y it is
the mean over `LINES` lines, which every direction places elsewhere (`line_shifts`). No ray is cast and nothing of the
size samples x directions is held: `geometry.contours` tells how.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.devices import moved
from torchlight.errors import ConfigError, ShapeError
from torchlight.geometry import contour_device
from torchlight.geometry.contours import Contours, scene_contours
from torchlight.geometry.crossings import GridContours, Rectangles, on_grid, visible_integrals
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.light.bases import Basis
from torchlight.precision import check_precision
from torchlight.threads import ordered_map

ALGORITHM = "transport-3"  # part of the cache key: raise it whenever the numbers change
MEMORY_BUDGET = 4 * 2**30  # bytes the transport itself may take
LINES = 2  # per row of samples and direction
DIRECTIONS_PER_CHUNK = 4096
VALUES_PER_CHUNK = 4_000_000  # samples x squares, 32 MB per thread
VALUES_ON_DEVICE = 2**25  # samples x squares, 256 MB
LATTICE = (0.7548776662466927, 0.5698402909980532)  # rank 1, from the plastic number (Roberts 2018)
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
        check_precision("transport", self.transport)
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
        """Returns T S, the transport of a basis: column i is the irradiance under basis function i alone.

        Linear in the transport, so torch differentiates it: dL/dT = (dL/d(T S)) S'.
        """
        if basis.resolution != self.resolution:
            raise ShapeError(f"basis resolution {basis.resolution} differs from the transport's {self.resolution}")
        return basis.project(self.transport)


def transport(
    scene: Scene,
    resolution: int,
    subsamples: int,
    progress: Progress | None = None,
    device: torch.device | str = "cpu",
) -> Transfer:
    """Returns the transport of a scene, float32.

    Args:
        scene: occluders and receiver.
        resolution: texels along a face's edge.
        subsamples: directions along a texel's edge.
        progress: called with (texels done, texels).
        device: where it is made and stays: by compiled code on a CPU, by the same method in torch elsewhere.

    Raises:
        ConfigError: the transport would exceed `MEMORY_BUDGET`, or there is no direction per texel.
    """
    check_subsamples(subsamples)
    texels = cubemap.texel_count(resolution)
    check_budget(scene.receiver.points, texels)
    result = torch.empty(scene.receiver.points, texels, dtype=torch.float32, device=device)
    for part, columns in cast(scene, cubemap.whole_texels(resolution), subsamples, device=device):
        result[:, part] = columns.T.float()
        if progress is not None:
            progress(part.stop, texels)
    return Transfer(result, resolution)


def square_columns(
    scene: Scene,
    squares: Int[Tensor, "squares 4"],
    subsamples: int,
    contours: Contours | None = None,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "squares points"]:
    """Returns the transport of squares of the cube map's faces, one row per square, float64.

    A square depends on nothing but itself: alone or among others, on one thread or many, it gets the same bits.

    Args:
        scene: occluders and receiver.
        squares: (face, level, row, column): a texel of the map with 2^level texels along a face's edge, with some
            part above z = 0.
        subsamples: directions along a square's edge.
        contours: from `scene_contours`, which is worth keeping for many calls.
        device: where they are made and stay; the squares are on the CPU.

    Raises:
        ConfigError: there is no direction per square, or no such square above the horizon.
    """
    check_subsamples(subsamples)
    check_squares(squares)
    result = torch.empty(len(squares), scene.receiver.points, dtype=torch.float64, device=device)
    for part, columns in cast(scene, cubemap.square_cells(squares), subsamples, contours, device):
        result[part] = columns
    return result


def cast(
    scene: Scene,
    cells: cubemap.Cells,
    subsamples: int,
    contours: Contours | None = None,
    device: torch.device | str = "cpu",
) -> Iterator[tuple[slice, Float[Tensor, "part points"]]]:
    """Yields the transport of cells [cells], some at a time and in their order."""
    contours = scene_contours(scene) if contours is None else contours
    shape = on_grid(contours, scene.receiver, LINES)
    count, points = len(cells.face), scene.receiver.points
    if torch.device(device).type != "cpu":
        yield from cast_on_device(shape, cells, subsamples, device)
        return
    step = max(1, min(DIRECTIONS_PER_CHUNK // subsamples**2, VALUES_PER_CHUNK // points))

    def integrate(part: slice) -> tuple[slice, Tensor]:
        rectangles = directions_of(some(cells, part), subsamples)
        return part, visible_integrals(shape, rectangles)

    yield from ordered_map(integrate, (slice(at, min(at + step, count)) for at in range(0, count, step)))


def cast_on_device(
    shape: GridContours, cells: cubemap.Cells, subsamples: int, device: torch.device | str
) -> Iterator[tuple[slice, Float[Tensor, "part points"]]]:
    """Yields what `cast` does, made by `geometry.contour_device`."""
    edges, count = contour_device.on_device(shape, device), len(cells.face)
    step = max(1, VALUES_ON_DEVICE // (shape.grid.rows * shape.grid.columns))
    for at in range(0, count, step):
        part = slice(at, min(at + step, count))
        rectangles = directions_of(some(cells, part), subsamples)
        yield part, contour_device.visible_integrals(edges, moved(rectangles, device))


def some(cells: cubemap.Cells, part: slice) -> cubemap.Cells:
    """Returns a part of the cells."""
    return cubemap.Cells(cells.face[part], cells.left[part], cells.right[part], cells.bottom[part], cells.top[part])


def directions_of(cells: cubemap.Cells, subsamples: int) -> Rectangles:
    """Returns each cell [cells] as a rectangle of subsamples x subsamples directions."""
    parts = cubemap.cut(cells, subsamples)
    frames = cubemap.face_frames()[cells.face]
    u, v = (cells.left + cells.right) / 2, (cells.bottom + cells.top) / 2
    shape = (len(cells.face), subsamples, subsamples)
    return Rectangles(
        center=frames[:, 2] + u[:, None] * frames[:, 0] + v[:, None] * frames[:, 1],
        right=frames[:, 0] * (cells.right - u)[:, None],
        up=frames[:, 1] * (cells.top - v)[:, None],
        directions=cubemap.cell_directions(parts).reshape(*shape, 3),
        weights=cubemap.cell_cosine_weights(parts).reshape(shape),
        shifts=line_shifts(cells, subsamples),
    )


def line_shifts(cells: cubemap.Cells, subsamples: int) -> Float[Tensor, "cells {subsamples} {subsamples}"]:
    """Returns where in its stratum each direction's lines lie, in [0, 1).

    A rank-1 lattice over all directions of a face, so that neither a texel nor its neighbourhood prefers a line; a
    direction keeps its line whatever other squares are asked for.
    """
    width = cells.right - cells.left
    first_row, first_column = torch.round((1 - cells.top) / width), torch.round((1 + cells.left) / width)
    step = torch.arange(subsamples, dtype=torch.float64)
    row = first_row[:, None] * subsamples + step
    column = first_column[:, None] * subsamples + step
    return (0.5 + row[:, :, None] * LATTICE[0] + column[:, None, :] * LATTICE[1]) % 1.0


def check_subsamples(subsamples: int) -> None:
    """Raises ConfigError unless there is a direction."""
    if subsamples < 1:
        raise ConfigError(f"subsamples: expected at least 1 direction along a texel's edge, got {subsamples}")


def check_squares(squares: Int[Tensor, "squares 4"]) -> None:
    """Raises ConfigError unless every square lies on one of the five faces and partly above the horizon."""
    face, level, row, column = squares.unbind(dim=1)
    edge = 2**level
    bottom = torch.where(face == cubemap.TOP_FACE, edge, (edge + 1) // 2)
    inside = (face >= 0) & (face < cubemap.PLANE_FACES) & (level >= 0) & (row >= 0) & (row < bottom)
    inside &= (column >= 0) & (column < edge)
    if not bool(inside.all()):
        wrong = squares[~inside][0].tolist()
        raise ConfigError(
            f"squares: (face, level, row, column) = {tuple(wrong)} is no square above the horizon; expected a face 0 "
            "to 4 and a row and a column below 2^level, on side faces rows of the upper half"
        )


def check_budget(points: int, texels: int) -> None:
    """Raises ConfigError when a float32 transport of this size would exceed the memory budget."""
    size = 4 * points * texels
    if size > MEMORY_BUDGET:
        raise ConfigError(
            f"the transport of {points:,} samples x {texels:,} texels needs {size / 2**30:.1f} GiB, more than "
            f"{MEMORY_BUDGET / 2**30:.0f} GiB; use fewer receiver.samples or a smaller --resolution"
        )
