"""The columns of the transport for the squares of a quadtree: coarse ones from the start, finer ones when asked for.

Column k is the irradiance of every sample under radiance 1 on square k alone. A dense transport gives the squares
down to its own texels; where a tree goes deeper, squares are cast when a photograph first needs them, and kept for
those that follow. A transport of 512 x 512 texels per face would be 25 GB; a few thousand of its squares are ever
asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.inversion.quadtree import pyramid, quadtree, squares, within
from torchlight.inversion.rows import Rows, SymmetricRows
from torchlight.threads import single_threaded_map
from torchlight.transfer import Transfer

UNKNOWN = -1  # quarters that have not been asked for
TEXEL = -2  # no quarters: the finest level
DENSE_RESOLUTION = 16  # as fine as this every square is cast beforehand; finer ones when a photograph asks
CELLS_PER_EDGE = 192  # directions along a face's edge, and
LEAST_CELLS = 4  # along a square's
MAX_KEPT = 2**26  # entries of the columns kept for later: 512 MiB; to cast them anew is a tenth of a solve
ROWS_PER_TASK = 256

Cast = Callable[[Int[Tensor, "squares 4"], int], Float[Tensor, "squares points"]]


class NodeColumns:
    """Columns of any squares of one scene; a cache of those that were asked for.

    Attributes:
        tree: all squares down to the finest level allowed.
        dense: columns of the squares of the dense transport, steradians weighted by the cosine, float64.
        node: which squares these are.
    """

    def __init__(self, transfer: Transfer, resolution: int, cast: Cast | None = None) -> None:
        """Takes the squares of a dense transport into a tree of N x N texels per face.

        Args:
            transfer: the transport, at most as fine as the tree.
            resolution: N.
            cast: columns of squares (face, level, row, column) by so many directions along their edge; None where
                the transport is as fine as the tree.

        Raises:
            ShapeError: the transport is finer than the tree, or coarser and nothing casts the rest.
        """
        if transfer.resolution > resolution or (cast is None and transfer.resolution < resolution):
            raise ShapeError(
                f"adaptive: max_resolution is {resolution}, the transport's {transfer.resolution}; "
                "precompute the scene for these settings"
            )
        device = transfer.transport.device
        self.coarse = quadtree(transfer.resolution, device=device)
        self.tree = quadtree(resolution, device=device)
        self.dense = pyramid(transfer.transport.to(torch.float64), transfer.resolution).T.contiguous()
        self.node = within(self.coarse, self.tree)
        self._cast = cast
        self._place = torch.full_like(self.tree.level, UNKNOWN)
        self._weighed: tuple[Tensor, Tensor] | None = None
        self._kept = Rows(self.dense[:0])

    @property
    def points(self) -> int:
        """Number of samples."""
        return self.dense.shape[1]

    def gram(self, root: Float[Tensor, " points"]) -> Float[Tensor, "nodes nodes"]:
        """Returns the inner products of the weighted columns of the dense transport; made once for equal weights."""
        if self._weighed is None or not torch.equal(self._weighed[0], root):
            columns = self.dense * root
            self._weighed = root, own_product(columns)
        return self._weighed[1]

    def of(self, nodes: Int[Tensor, " k"]) -> Float[Tensor, "k points"]:
        """Returns the columns of any squares."""
        place = torch.full_like(self.tree.level, UNKNOWN)
        place[self.node] = torch.arange(self.node.shape[0], device=place.device)
        dense = place[nodes] != UNKNOWN
        columns = self.dense.new_empty(nodes.shape[0], self.points)
        columns[dense] = self.dense[place[nodes[dense]]]
        if not bool(dense.all()):
            columns[~dense] = self.finer(nodes[~dense])
        return columns

    def finer(self, nodes: Int[Tensor, " k"]) -> Float[Tensor, "k points"]:
        """Returns the columns of squares finer than the dense transport, cast now where they are not kept."""
        missing = nodes[self._place[nodes] == UNKNOWN]
        if missing.shape[0] > 0:
            if (self.kept + missing.shape[0]) * self.points > MAX_KEPT:
                self._place.fill_(UNKNOWN)
                self._kept, missing = Rows(self.dense[:0]), nodes
            self._place[missing] = self.kept + torch.arange(missing.shape[0], device=nodes.device)
            self._kept.append(self._columns(missing))
        return self._kept.all[self._place[nodes]]

    @property
    def kept(self) -> int:
        """Number of squares finer than the dense transport that are kept."""
        return self._kept.all.shape[0]

    def _columns(self, nodes: Int[Tensor, " k"]) -> Float[Tensor, "k points"]:
        if self._cast is None:
            raise ShapeError("adaptive: squares finer than the transport were asked for, but nothing casts them")
        columns = self.dense.new_empty(nodes.shape[0], self.points)
        levels = self.tree.level[nodes]
        for level in levels.unique().tolist():
            here = levels == level
            cells = max(LEAST_CELLS, CELLS_PER_EDGE >> level)
            columns[here] = self._cast(squares(self.tree, nodes[here]).cpu(), cells).to(columns)
        return columns


class WeightedNodes:
    """The squares that some photographs of equal weights work with, and the Gram matrix of their columns.

    Squares are known by their places here, which never change; `divide` adds the quarters of some.

    Attributes:
        source: where columns come from.
        root: W^(1/2).
        node: the square at every place; those of the dense transport come first.
        children: the places of its four quarters; UNKNOWN, or TEXEL at the finest level.
        parent: the place of the square it is a quarter of; UNKNOWN for the nine coarsest.
    """

    def __init__(self, source: NodeColumns, root: Float[Tensor, " points"]) -> None:
        """Weighs the squares of the dense transport."""
        self.source, self.root = source, root
        coarse = source.coarse
        finest = TEXEL if coarse.resolution == source.tree.resolution else UNKNOWN
        self.node = source.node
        self.children = torch.full((coarse.size, 4), finest, device=root.device)
        self.children[coarse.supports] = coarse.children
        self.parent = coarse.parent
        self._columns = Rows(source.dense * root)
        self._gram = SymmetricRows(source.gram(root))

    @property
    def roots(self) -> Int[Tensor, " roots"]:
        """Places of the nine coarsest squares."""
        return self.source.coarse.roots

    @property
    def columns(self) -> Float[Tensor, "slots points"]:
        """W^(1/2) A, one column of it per row here."""
        return self._columns.all

    @property
    def gram(self) -> Float[Tensor, "slots slots"]:
        """Inner products of the columns, the same whatever the number of threads."""
        return self._gram.all

    @property
    def gram_and_room(self) -> Float[Tensor, "room room"]:
        """The Gram matrix in the upper left of a contiguous matrix; the rest means nothing."""
        return self._gram.room

    def unweighted(self) -> Float[Tensor, "slots points"]:
        """Returns A, one column of it per row here."""
        dense = self.source.dense
        finer = self.node[dense.shape[0] :]
        return torch.cat([dense, self.source.finer(finer)]) if finer.shape[0] > 0 else dense

    def divide(self, places: Int[Tensor, " k"]) -> Float[Tensor, "fresh points"]:
        """Takes in the quarters of these squares, and returns their weighted columns."""
        wanted = torch.unique(places)
        wanted = wanted[self.children[wanted, 0] == UNKNOWN]
        tree, known = self.source.tree, self.node.shape[0]
        nodes = tree.children[tree.support_of[self.node[wanted]]].reshape(-1)
        self.children[wanted] = known + torch.arange(nodes.shape[0], device=nodes.device).reshape(-1, 4)
        finest = torch.where(tree.support_of[nodes] < 0, TEXEL, UNKNOWN)
        self.children = torch.cat([self.children, finest[:, None].expand(-1, 4)])
        self.parent = torch.cat([self.parent, wanted.repeat_interleave(4)])
        self.node = torch.cat([self.node, nodes])
        fresh = self.source.finer(nodes) * self.root
        self._columns.append(fresh)
        self._gram.append(product(fresh, self.columns))
        return fresh


def own_product(rows: Float[Tensor, "n points"]) -> Float[Tensor, "n n"]:
    """Returns the inner products of rows with each other, made above the diagonal and copied below, as `product` is."""
    if rows.device.type != "cpu":
        return rows @ rows.T
    result = rows.new_empty(rows.shape[0], rows.shape[0])

    def fill(start: int) -> None:
        block = rows[start : start + ROWS_PER_TASK] @ rows[start:].T
        square = block[:, : block.shape[0]].triu()
        block[:, : block.shape[0]] = square + square.triu(1).T
        result[start : start + ROWS_PER_TASK, start:] = block
        result[start:, start : start + ROWS_PER_TASK] = block.T

    for _ in single_threaded_map(fill, range(0, rows.shape[0], ROWS_PER_TASK)):
        pass
    return result


def product(left: Float[Tensor, "n points"], right: Float[Tensor, "m points"]) -> Float[Tensor, "n m"]:
    """Returns the inner products of rows; on a CPU bit by bit the same whatever the number of threads."""
    if left.device.type != "cpu":
        return left @ right.T
    result = left.new_empty(left.shape[0], right.shape[0])

    def fill(start: int) -> None:
        torch.matmul(left[start : start + ROWS_PER_TASK], right.T, out=result[start : start + ROWS_PER_TASK])

    for _ in single_threaded_map(fill, range(0, left.shape[0], ROWS_PER_TASK)):
        pass
    return result
