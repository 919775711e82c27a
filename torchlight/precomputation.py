"""The transport of a scene, made once and kept on disk, as each method takes it."""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch

from torchlight.geometry.contours import scene_contours
from torchlight.geometry.scene import Scene, shadowing
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.nodes import NodeColumns
from torchlight.io import cache
from torchlight.light.bases import Basis
from torchlight.solvers import Solver
from torchlight.transfer import ALGORITHM, Transfer, square_columns, transport

DIRECTIONS_PER_EDGE = 192  # see docs/convergence.md
Columns = Transfer | NodeColumns
Progress = Callable[[int, int], None]


def columns_for(
    scene: Scene,
    basis: Basis,
    solver: Solver | AdaptiveHaar,
    use_cache: bool = True,
    progress: Progress | None = None,
    device: torch.device | str = "cpu",
) -> Columns:
    """Returns what a solve takes of a scene: its dense transport, or for `AdaptiveHaar` columns on demand beside it.

    Keep it for all photographs of the scene: `NodeColumns` remember what they have cast. All columns are made on the
    device and stay there, but for the paper's rule (`home`).
    """
    if not isinstance(solver, AdaptiveHaar):
        return precompute(scene, basis.resolution, use_cache=use_cache, progress=progress, device=device)
    dense = precompute(
        scene, solver.dense_resolution, use_cache=use_cache, progress=progress, device=home(solver, device)
    )
    return deepened(scene, dense, solver.max_resolution)


def home(solver: AdaptiveHaar, device: torch.device | str) -> torch.device | str:
    """Returns where trees grow: on the device by `ProjectedGain`, on the CPU by rules that work item by item."""
    return device if isinstance(solver.rule, ProjectedGain) else "cpu"


def dense_resolution(basis: Basis, solver: Solver | AdaptiveHaar) -> int:
    """Returns the resolution of the dense transport that a method takes."""
    return solver.dense_resolution if isinstance(solver, AdaptiveHaar) else basis.resolution


def deepened(scene: Scene, dense: Transfer, resolution: int) -> NodeColumns:
    """Returns the columns of all squares down to a resolution, those finer than the dense transport cast on demand."""
    contours = functools.cache(lambda: scene_contours(scene))
    device = dense.transport.device
    return NodeColumns(
        dense, resolution, lambda squares, cells: square_columns(scene, squares, cells, contours(), device)
    )


def fitting(scene: Scene, transfer: Columns, solver: Solver | AdaptiveHaar, device: torch.device) -> Columns:
    """Returns what the solver takes: a dense transport on the observation's device, deepened where it is too coarse."""
    if not isinstance(transfer, Transfer):
        return transfer
    if not isinstance(solver, AdaptiveHaar):
        return transfer.to(device=device)
    transfer = transfer.to(device=home(solver, device))
    if transfer.resolution < solver.max_resolution:
        return deepened(scene, transfer, solver.max_resolution)
    return transfer


def precompute(
    scene: Scene,
    resolution: int = 16,
    subsamples: int | None = None,
    use_cache: bool = True,
    progress: Progress | None = None,
    device: torch.device | str = "cpu",
) -> Transfer:
    """Returns the transport of a scene, from the disk cache if it is there: the slow part, shared by all photos.

    Args:
        scene: occluders and receiver; camera, mask, reference and albedo play no part.
        resolution: texels along a cube map face's edge.
        subsamples: directions along a texel's edge; None = as many as make 192 along a face's edge, at least 2.
        use_cache: False = neither read nor write the cache.
        progress: called with (work done, work).
        device: where it is made, if it is not in the cache, and put.
    """
    count = subsamples if subsamples is not None else max(2, DIRECTIONS_PER_EDGE // resolution)
    if not use_cache:
        return transport(scene, resolution, count, progress, device)
    key = transport_key(scene, resolution, count)
    stored = cache.load(key)
    if stored is not None:
        return Transfer(stored["transport"], resolution).to(device)
    result = transport(scene, resolution, count, progress, device)
    cache.store(key, {"transport": result.transport}, {"algorithm": ALGORITHM, "resolution": str(resolution)})
    return result


def transport_key(scene: Scene, resolution: int, subsamples: int) -> str:
    """Returns the content key of a transport: everything its numbers depend on, and nothing else."""
    receiver = scene.receiver
    return cache.content_key(
        {
            "triangles": shadowing(scene).triangles,
            "center": receiver.center,
            "size": receiver.size,
            "samples": receiver.samples,
            "resolution": resolution,
            "subsamples": subsamples,
            "algorithm": ALGORITHM,
        }
    )
