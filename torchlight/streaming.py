"""Light frame by frame: a video under a fixed camera, block by block, as fast as it comes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.solvers.prepared import prepare
from torchlight.solvers.solution import Solution


def stream(
    matrix: Float[Tensor, "points texels"],
    blocks: Iterable[Float[Tensor, "frames 3 points"]],
    weights: Float[Tensor, " points"] | None = None,
    tolerance: float = 1e-5,
) -> Iterator[Solution]:
    """Returns the non-negative light of every frame: argmin |W^(1/2) (T x - b)|^2 / 2 over x >= 0, block after block.

    What the frames share is made at once: the Gram matrix, its eigenvectors, the columns that are seen. A block is read
    when its solution is asked for, and nothing is kept of it: memory is that of one block, however many there are.
    Blocks of 16 to 32 frames are solved at the full rate; smaller ones come sooner (`docs/streams.md`).

    Every frame is solved for itself. A frame that holds NaN or infinity has the status NOT_FINITE and no light; a black
    one has none either, and that is its exact answer. Neither stops the stream nor touches another frame.

    Args:
        matrix: T, the transport of the texels: `Transfer.transport`; where it is, there blocks are solved.
        blocks: irradiance samples b of consecutive frames, of the matrix's dtype.
        weights: the diagonal of W, the same for all frames; 0 where a sample does not count. None = ones.
        tolerance: on `Solution.kkt_residual`, here the largest cosine between the residual b - T x and a column that
            should be at right angles with it (`certificate.kkt_cosine`).

    Raises:
        ShapeError: matrix and weights do not fit; when a block is asked for, that this block does not.
        ConfigError: the tolerance is not in (0, 1), or the matrix has no column or too many.
    """
    if not 0.0 < tolerance < 1.0:
        raise ConfigError(f"stream: expected a tolerance in (0, 1), got {tolerance}")
    prepared = prepare(matrix, weights)
    return (prepared.solve(block, tolerance) for block in blocks)
