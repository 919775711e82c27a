"""Inner products of a scene's columns under any weights: whole once per scene, and changed for the samples left out."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.analysis.observability import coarsened, resolution_diagonal
from torchlight.inversion.nodes import NodeColumns, product
from torchlight.inversion.quadtree import texel_nodes
from torchlight.light.bases import Basis
from torchlight.transfer import Transfer

OBSERVED_RESOLUTION = 16  # texels along a face's edge of an observability map, where the method has as many


class Equations:
    """The columns A of some unknowns in float64, and A'W A for the weights asked for last.

    Samples of another weight than 1 are taken out of A'A where they are fewer than half, so that thousands of
    photographs, each with a few samples of its own left out, cost little. The bits depend on the weights alone.
    """

    def __init__(self, columns: Float[Tensor, "n points"]) -> None:
        """Keeps the columns, one per row here."""
        self.columns = columns
        self._whole: Tensor | None = None
        self._last: tuple[Tensor, Tensor] | None = None
        self._told: tuple[Tensor, float, Tensor] | None = None

    def gram(self, weights: Float[Tensor, " points"]) -> Float[Tensor, "n n"]:
        """Returns A'W A."""
        if self._last is None or not torch.equal(self._last[0], weights):
            self._last = weights, self._weighted(weights)
        return self._last[1]

    def observability(self, weights: Float[Tensor, " points"], noise: float) -> Float[Tensor, " n"]:
        """Returns R_ii where noise is a share of the brightest used sample under uniform light (`whitened`).

        Kept for the next photograph: the noise of many is the least there is, that of rounding to 8 bits.
        """
        if self._told is None or self._told[1] != noise or not torch.equal(self._told[0], weights):
            brightest = (self.columns.sum(dim=0) * (weights > 0)).max().clamp(min=1e-300)
            self._told = weights, noise, resolution_diagonal(self.gram(weights) / brightest.square(), noise)
        return self._told[2]

    def _weighted(self, weights: Float[Tensor, " points"]) -> Float[Tensor, "n n"]:
        changed = weights != 1
        if 2 * int(changed.sum()) > weights.shape[0]:
            rows = self.columns[:, weights > 0] * weights[weights > 0].sqrt()
            return product(rows, rows)
        if self._whole is None:
            self._whole = product(self.columns, self.columns)
        taken = self.columns[:, changed]
        return self._whole - product(taken * (1 - weights[changed]), taken)


_OF_TEXELS: WeakKeyDictionary[Transfer | NodeColumns, dict[int, Equations]] = WeakKeyDictionary()
_OF_BASIS: WeakKeyDictionary[Transfer, dict[Basis, tuple[Equations, Tensor | None]]] = WeakKeyDictionary()
_NODES: WeakKeyDictionary[Transfer, NodeColumns] = WeakKeyDictionary()


def texel_equations(columns: Transfer | NodeColumns, resolution: int) -> Equations:
    """Returns the equations of a scene's texels, at most as fine as its transport; kept as long as the columns are."""
    kept = _OF_TEXELS.setdefault(columns, {})
    if resolution not in kept:
        kept[resolution] = Equations(_texel_columns(columns, resolution))
    return kept[resolution]


def basis_equations(transfer: Transfer, basis: Basis) -> tuple[Equations, Float[Tensor, "texels coeffs"] | None]:
    """Returns the equations of a basis' coefficients, and S (None: 1); kept as long as the transport is."""
    kept = _OF_BASIS.setdefault(transfer, {})
    if basis not in kept:
        synthesis = basis.synthesis_matrix()
        transport = transfer.transport.detach().cpu().double()
        matrix = transport if synthesis is None else transport @ synthesis
        kept[basis] = Equations(matrix.T.contiguous()), synthesis
    return kept[basis]


def node_columns(columns: Transfer | NodeColumns, resolution: int) -> NodeColumns:
    """Returns the columns of squares, made of a transport where they are not there."""
    if isinstance(columns, NodeColumns):
        return columns
    if columns not in _NODES:
        _NODES[columns] = NodeColumns(columns.to("cpu"), resolution)
    return _NODES[columns]


def observed_resolution(columns: Transfer | NodeColumns) -> int:
    """Returns the texels along a face's edge that a scene's observability is told on."""
    finest = columns.coarse.resolution if isinstance(columns, NodeColumns) else columns.resolution
    return min(finest, OBSERVED_RESOLUTION)


def _texel_columns(columns: Transfer | NodeColumns, resolution: int) -> Float[Tensor, "texels points"]:
    if isinstance(columns, NodeColumns):
        return columns.dense[texel_nodes(columns.coarse)].cpu()
    transfer = columns if columns.resolution == resolution else coarsened(columns, resolution)
    return transfer.transport.detach().cpu().double().T.contiguous()
