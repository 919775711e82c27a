"""Which Haar functions an adaptive solve uses and why no others: a picture of the cube's faces and a table per level.

The five faces are shown unfolded, seen from inside, as in docs/conventions.md: the upper halves of +y, +x, -y, -x
side by side, and +z above +x, whose top edge it shares.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from torch import Tensor

from torchlight.figures import add_axes, png_bytes
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
PLACES = {"+y": 0, "+x": 1, "-y": 2, "-x": 3, "+z": 1}  # faces to the left of each
WIDTH, HEIGHT, SIDE_TOP = 4.0, 1.5, 0.5
FACES_INCHES, CHANNEL_INCHES, LEGEND_INCHES = 2.6, 2.95, 0.45
HEAD_ROWS, LEAST_ROWS = 1.8, 11.0  # of the table: its head counts as so many; fewer rows are not drawn taller


def fates_picture(refinement: Refinement, resolution: int) -> bytes:
    """Returns a PNG of the faces per channel: squares of constant light, coloured by why they are not finer.

    A square whose smallest support is in use is RESOLVED. The table of `fate_counts` stands below.

    Args:
        refinement: of one photograph.
        resolution: texels along a face's edge, as the solve's `max_resolution`.
    """
    tree = quadtree(resolution)
    channels = refinement.kept.shape[0]
    figure = Figure(figsize=(11.0, CHANNEL_INCHES * channels + LEGEND_INCHES), dpi=110)
    for channel in range(channels):
        bottom = LEGEND_INCHES + CHANNEL_INCHES * (channels - 1 - channel)
        faces, counts = (add_axes(figure, x, bottom, width, FACES_INCHES) for x, width in ((0.08, 6.45), (6.6, 4.3)))
        kept, fate = refinement.kept[channel].cpu(), refinement.fate[channel].cpu()
        draw_fates(faces, tree, kept, fate)
        regions = int(refinement.regions[channel])
        name = CHANNELS[channel] if channels == len(CHANNELS) else f"channel {channel}"
        faces.set_title(f"{name}: {int(kept.sum())} functions, {regions} squares", fontsize=10, y=1.0)
        draw_counts(counts, fate_counts(tree, kept, fate))
    shown = {Fate(value) for value in refinement.fate.unique().tolist()}
    handles = [Patch(facecolor=COLOURS[fate], edgecolor="0.4", label=NAMES[fate]) for fate in Fate if fate in shown]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False)
    return png_bytes(figure)


def draw_fates(axis: Axes, tree: Quadtree, kept: Bool[Tensor, " coeffs"], fate: Int[Tensor, " supports"]) -> None:
    """Draws the fates of one channel and the borders of the squares on which its light is constant."""
    colours = ListedColormap([COLOURS[value] for value in Fate])
    limits = BoundaryNorm(np.arange(len(Fate) + 1) - 0.5, len(Fate))
    shown = unfolded(texel_fates(tree, fate).double(), tree.resolution).numpy()
    axis.imshow(shown, extent=(0, WIDTH, 0, HEIGHT), cmap=colours, norm=limits, interpolation="nearest")
    draw_leaves(axis, tree, kept)
    label_faces(axis)


def draw_leaves(axis: Axes, tree: Quadtree, kept: Bool[Tensor, " coeffs"], colour: str = "0.35") -> None:
    """Draws the borders of the squares on which a light of these Haar functions is constant."""
    leaves = tree.leaves(needed(tree, kept))
    axis.add_collection(LineCollection(list(outlines(tree, leaves).numpy()), colors=colour, linewidths=0.4))


def draw_counts(axis: Axes, counts: Int[Tensor, "levels fates"]) -> None:
    """Writes how many supports of each level met which fate."""
    axis.set_axis_off()
    fates = [fate for fate in Fate if int(counts[:, fate].sum()) > 0]
    head = ["level", *(NAMES[fate].replace(" ", "\n", 1).replace("-", "-\n") for fate in fates)]
    height = HEAD_ROWS + len(counts)
    axis.set_xlim(0, len(head))
    axis.set_ylim(max(height, LEAST_ROWS), 0)  # rows are counted downwards
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
    for column, name in enumerate(head):
        axis.text(column + 0.5, HEAD_ROWS / 2, name, **style)
        for level, count in enumerate(counts[:, fates[column - 1]].tolist() if column else range(len(counts))):
            axis.text(column + 0.5, HEAD_ROWS + level + 0.5, str(count), **style)
    axis.hlines([0, *(HEAD_ROWS + level for level in range(len(counts) + 1))], 0, len(head), color="0.8", linewidth=1)


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


def label_faces(axis: Axes) -> None:
    """Frames and names the faces, and takes the axes away."""
    for name, left in PLACES.items():
        bottom, height = (SIDE_TOP, 1.0) if name == "+z" else (0.0, SIDE_TOP)
        axis.add_patch(Rectangle((left, bottom), 1, height, fill=False, edgecolor="black", linewidth=0.9))
        below = name != "+z"
        axis.annotate(
            name,
            (left + (0.5 if below else 0.0), bottom + (0.0 if below else 0.5)),
            (0, -3) if below else (-4, 0),
            textcoords="offset points",
            ha="center" if below else "right",
            va="top" if below else "center",
            fontsize=8,
        )
    axis.set_xlim(-0.02, WIDTH + 0.02)
    axis.set_ylim(-0.12, HEIGHT + 0.02)
    axis.set_aspect("equal")
    axis.set_axis_off()
