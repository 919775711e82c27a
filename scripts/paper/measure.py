"""One measurement: a method's light from the photograph, scored on the photograph and on the poses never shown."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.inversion.nodes import DENSE_RESOLUTION, NodeColumns
from torchlight.inversion.quadtree import pyramid
from torchlight.inversion.refinement import Refinement, needed
from torchlight.light import haar
from torchlight.photo.observation import Observation
from torchlight.precomputation import Columns, deepened, precompute
from torchlight.relighting import irradiance
from torchlight.solvers import Ridge, Status
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer

from .harmonics import lstsq_difference
from .methods import METHODS, Family, Found, Method, find
from .setting import PHOTOGRAPHED, POSES, RECEIVER, Exposed, used_samples

Transfers = Mapping[tuple[Block, int], Transfer]
AllColumns = Mapping[str, Columns]


@dataclass(frozen=True)
class Row:
    """One measurement: RMS of 255 on the photograph and on the other poses, and the seconds of the solve.

    Attributes:
        probe: the light.
        method: of `METHODS`.
        family: of the method.
        noise: added to the photograph, as a share of the brightest sample.
        settings: basis and solver, where they were chosen on the photograph.
        functions: most per channel of those in use.
        regions: most per channel of squares of constant light, if any.
        fit: on the photograph.
        held_out: on each of the other poses.
        seconds: of the solve, all three channels, without what is shared by all photographs of the scene.
        converged: whether every channel's solve reached its tolerance.
        kkt_residual: distance from the optimality conditions.
        lstsq_difference: of the objective from numpy.linalg.lstsq's, relative, for plain least squares.
    """

    probe: str
    method: str
    family: str
    noise: float
    settings: str
    functions: int
    regions: int | None
    fit: float
    held_out: tuple[float, ...]
    seconds: float
    converged: bool
    kkt_residual: float
    lstsq_difference: float | None

    @property
    def mean(self) -> float:
        """Mean over the other poses."""
        return sum(self.held_out) / len(self.held_out)

    @property
    def worst(self) -> float:
        """Largest of the other poses."""
        return max(self.held_out)


def precomputed(methods: Sequence[Method]) -> Transfers:
    """Returns the transports that the methods need, of every pose: the slow part, shared by all lights."""
    work = [(block, resolution) for resolution in sorted({m.resolution for m in methods}) for block in POSES]
    return {
        (block, resolution): precompute(block_scene(block, RECEIVER), resolution)
        for block, resolution in tqdm(work, desc="transport", disable=not sys.stderr.isatty())
    }


def all_columns(methods: Sequence[Method], transfers: Transfers) -> AllColumns:
    """Returns what each method takes of the photographed pose; columns that it casts on demand serve all lights."""
    scene = block_scene(PHOTOGRAPHED, RECEIVER)
    return {
        method.name: transfers[PHOTOGRAPHED, method.resolution]
        if method.finest is None
        else deepened(scene, transfers[PHOTOGRAPHED, method.resolution], method.finest)
        for method in methods
    }


def measure(
    probe: str, method: Method, seen: Exposed, transfers: Transfers, columns: Columns, noise: float
) -> tuple[Row, Found]:
    """Returns a line of the table and the light behind it."""
    transfer = transfers[PHOTOGRAPHED, method.resolution]
    start = time.perf_counter()
    found = find(method, transfer, columns, seen.photo, noise)
    seconds = time.perf_counter() - start
    scores = [
        metrics.rms_255(relit(block, found, transfers), truth.samples, truth.weights).item()
        for block, truth in zip(POSES, (seen.photo, *seen.truth[1:]), strict=True)
    ]
    refinement = found.refinement
    row = Row(
        probe=probe,
        method=method.name,
        family=method.family.value,
        noise=noise,
        settings=described(found),
        functions=found.basis.size if refinement is None else int(refinement.functions.max()),
        regions=None if refinement is None else int(refinement.regions.max()),
        fit=scores[0],
        held_out=tuple(scores[1:]),
        seconds=seconds,
        converged=bool((found.solution.status == Status.CONVERGED).all()),
        kkt_residual=found.solution.kkt_residual.max().item(),
        lstsq_difference=checked(found, transfer, seen.photo),
    )
    return row, found


def described(found: Found) -> str:
    """Returns basis and solver as text."""
    return f"{found.basis}, {found.solver}"


def checked(found: Found, transfer: Transfer, photo: Observation) -> float | None:
    """Returns the distance from numpy.linalg.lstsq where the method is plain least squares."""
    if found.solver != Ridge():
        return None
    return lstsq_difference(transfer.project(found.basis), Observation(photo.samples * torch.pi, photo.weights))


def relit(block: Block, found: Found, transfers: Transfers) -> Float[Tensor, "3 points"]:
    """Returns v = E / pi of a pose under the light found.

    By the pose's own transport where it is as fine as the light, else by the columns of the light's squares.
    """
    coefficients = found.solution.coefficients
    transfer = transfers.get((block, found.basis.resolution))
    if transfer is not None:
        return irradiance(transfer.project(found.basis), coefficients) / torch.pi
    if found.refinement is None:
        raise ValueError(f"no transport of {found.basis.resolution} texels was made for {found.basis}")
    return relit_by_squares(pose_columns(block, found.basis.resolution), coefficients, found.refinement) / torch.pi


@cache
def pose_columns(block: Block, resolution: int) -> NodeColumns:
    """Returns the columns of a pose, kept for all lights."""
    scene = block_scene(block, RECEIVER)
    return deepened(scene, precompute(scene, DENSE_RESOLUTION), resolution)


def relit_by_squares(
    columns: NodeColumns, coefficients: Float[Tensor, "3 coeffs"], refinement: Refinement
) -> Float[Tensor, "3 points"]:
    """Returns the irradiance of a light that is constant on the squares of a tree."""
    tree = columns.tree
    texels = haar.synthesis(coefficients.double(), tree.resolution)
    sums, shown = pyramid(texels, tree.resolution), []
    for channel, kept in enumerate(refinement.kept):
        leaves = tree.leaves(needed(tree, kept))
        radiance = sums[channel, leaves] * 4.0 ** tree.level[leaves].double() / tree.resolution**2
        shown.append(radiance @ columns.of(leaves))
    return torch.stack(shown).to(coefficients)


def warm_up(transfers: Transfers, columns: AllColumns) -> None:
    """Solves once by each adaptive method: the compiler's work and the casting of the first squares are not timed."""
    photo = Observation(torch.ones(3, RECEIVER.points), used_samples(PHOTOGRAPHED).float())
    for method in METHODS:
        if method.family is Family.HAAR:
            find(method, transfers[PHOTOGRAPHED, method.resolution], columns[method.name], photo, 0.0)
