"""Which Haar functions an adaptive solve uses and why no others: a picture of the cube's faces and a table per level.

The five faces are shown unfolded, seen from inside, as in docs/conventions.md: the upper halves of +y, +x, -y, -x
side by side, and +z above +x, whose top edge it shares.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.drawing.content import HEIGHT, PLACES, SIDE_TOP, ChannelFates, FatesContent
from torchlight.drawing.elsewhere import draw
from torchlight.inversion.quadtree import Quadtree, quadtree, spread, squares
from torchlight.inversion.refinement import NAMES, Fate, Refinement, fate_counts, needed
from torchlight.light import cubemap

COLOURS = {  # after Okabe and Ito: told apart with every common colour blindness, and in grey
    Fate.RESOLVED: "#0072B2",
    Fate.BELOW_THRESHOLD: "#F3EFD8",
    Fate.ILL_CONDITIONED: "#E69F00",
    Fate.UNSEEN: "#2B2B2B",
    Fate.LIMIT: "#CC79A7",
    Fate.UNSOLVED: "#009E73",
}
CHANNELS = ("red", "green", "blue")


def fates_picture(refinement: Refinement, resolution: int) -> bytes:
    """Returns a PNG of `fates_content`."""
    return draw(fates_content(refinement, resolution))


def fates_content(refinement: Refinement, resolution: int) -> FatesContent:
    """Returns the faces per channel: squares of constant light, coloured by why they are not finer.

    A square whose smallest support is in use is RESOLVED. The table of `fate_counts` stands beside it.

    Args:
        refinement: of one photograph.
        resolution: texels along a face's edge, as the solve's `max_resolution`.
    """
    shown = {Fate(value) for value in refinement.fate.unique().tolist()}
    return FatesContent(
        tuple(_channel(refinement, resolution, channel) for channel in range(refinement.kept.shape[0])),
        tuple(COLOURS[value] for value in Fate),
        tuple((COLOURS[fate], NAMES[fate]) for fate in Fate if fate in shown),
    )


def _channel(refinement: Refinement, resolution: int, channel: int) -> ChannelFates:
    tree = quadtree(resolution)
    kept, fate = refinement.kept[channel].cpu(), refinement.fate[channel].cpu()
    name = CHANNELS[channel] if refinement.kept.shape[0] == len(CHANNELS) else f"channel {channel}"
    counts = fate_counts(tree, kept, fate)
    fates = [value for value in Fate if int(counts[:, value].sum()) > 0]
    return ChannelFates(
        f"{name}: {int(kept.sum())} functions, {int(refinement.regions[channel])} squares",
        unfolded(texel_fates(tree, fate).float(), resolution).numpy(),
        borders(tree, kept).numpy(),
        ("level", *(NAMES[value].replace(" ", "\n", 1).replace("-", "-\n") for value in fates)),
        tuple((level, *row) for level, row in enumerate(counts[:, fates].tolist())),
    )


def borders(tree: Quadtree, kept: Bool[Tensor, " coeffs"]) -> Float[Tensor, "squares 5 2"]:
    """Returns the borders of the squares on which a light of these Haar functions is constant."""
    return outlines(tree, tree.leaves(needed(tree, kept)))


def texel_fates(tree: Quadtree, fate: Int[Tensor, " supports"]) -> Int[Tensor, " texels"]:
    """Returns for every visible texel the fate of the smallest support that holds it."""
    smallest = (tree.level[tree.supports] == tree.level.max() - 1).nonzero()[:, 0]
    values = torch.zeros(tree.size, dtype=torch.float64)
    values[tree.supports[smallest]] = fate[smallest].double()
    return spread(values, tree.resolution).round().long()


# --- the unfolded faces --------------------------------------------------------------------------------------------


def unfolded(texels: Float[Tensor, "*batch texels"], resolution: int) -> Float[Tensor, "*batch rows columns"]:
    """Returns the five faces as one picture of 3 N / 2 rows and 4 N columns, NaN where no face is."""
    faces = cubemap.scatter_to_faces(texels, resolution)
    half = resolution // 2
    picture = torch.full((*texels.shape[:-1], 3 * half, 4 * resolution), torch.nan, dtype=texels.dtype)
    for face, name in enumerate(cubemap.FACES[: cubemap.PLANE_FACES]):
        left = PLACES[name] * resolution
        top, rows = (0, resolution) if face == cubemap.TOP_FACE else (resolution, half)
        picture[..., top : top + rows, left : left + resolution] = faces[..., face, :rows, :]
    return picture


def outlines(tree: Quadtree, nodes: Int[Tensor, " nodes"]) -> Float[Tensor, "nodes 5 2"]:
    """Returns the closed border of squares on the unfolded faces: x to the right, y up, faces of side 1."""
    face, level, row, column = squares(tree, nodes).unbind(dim=-1)
    side = 2.0 ** -level.double()
    places = torch.tensor([PLACES[name] for name in cubemap.FACES[: cubemap.PLANE_FACES]])
    left = places[face] + column * side
    top = torch.where(face == cubemap.TOP_FACE, HEIGHT, SIDE_TOP) - row * side
    x = torch.stack([left, left + side, left + side, left, left], dim=-1)
    y = torch.stack([top, top, top - side, top - side, top], dim=-1)
    return torch.stack([x, y], dim=-1)
