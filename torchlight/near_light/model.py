"""Light at a height, as distant light on a stretched object.

The map of `torchlight.light_plane` makes light on a plane at a height h = 1 / k distant light on a stretched object, so
that the transport of `torchlight.transfer` serves for any k; k = 0 is distant light.

What a lamp's shadow tells of its height is therefore how much larger the upper parts of the object throw their shadow
than the lower ones: by the factor 1 / (1 - k z). The fall-off of a near lamp over the plane also tells, but so do
vignetting and uneven paper; it is no evidence here, and any smooth one is fitted and let go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight import light_plane
from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.inversion import quadtree
from torchlight.light import cubemap
from torchlight.photo.reference import quadratic_terms

COARSE = 4  # squares along a face's edge to begin with
FINE = 128  # and at most: 0.7 degrees
SHARE = 0.02  # of all flux: a square that holds more is cut into four
BRIGHT = 0.1  # of all flux: so are the neighbours of one that holds more, or a dark one might never get its turn
TOUCH = 1.1  # angle between centres of neighbours, in the mean of their sides


@dataclass(frozen=True, eq=False)
class Shadow:
    """One photograph of one scene, prepared for fits at any height.

    Attributes:
        scene: occluders and receiver.
        centre: the fixed point c of the map: the middle of the object, so that directions depend little on k.
        used: which samples count.
        root: square roots of their weights.
        values: their grey values, mean 1.
        terms: smooth fall-off, quadratic in x and y.
    """

    scene: Scene
    centre: Float[Tensor, "2"]
    used: Bool[Tensor, " points"]
    root: Float[Tensor, " used"]
    values: Float[Tensor, " used"]
    terms: Float[Tensor, "used 5"]

    @property
    def top(self) -> float:
        """Height of the object."""
        return float(self.scene.triangles[..., 2].max())


def shadow_of(scene: Scene, samples: Float[Tensor, "channels points"], weights: Float[Tensor, " points"]) -> Shadow:
    """Returns a photograph prepared for fits; channels are averaged."""
    used = weights > 0
    values = samples.double().mean(dim=0)[used]
    corners = scene.triangles.reshape(-1, 3)[:, :2].double()
    return Shadow(
        scene=scene,
        centre=(corners.amin(dim=0) + corners.amax(dim=0)) / 2,
        used=used,
        root=weights[used].double().sqrt(),
        values=values / values.mean(),
        terms=quadratic_terms(sample_centers(scene.receiver))[used, 1:],
    )


def stretched(scene: Scene, centre: Float[Tensor, "2"], curvature: float) -> Scene:
    """Returns the scene whose distant light acts as light at the height 1 / curvature acts on this one.

    Args:
        scene: occluders, all of them below that height, and receiver.
        centre: c, the foot of the perpendicular from which directions are counted.
        curvature: k, per unit of length.
    """
    return replace(scene, triangles=light_plane.stretched(scene.triangles, centre, curvature), light_plane=None)


def coarse_squares() -> Int[Tensor, "squares 4"]:
    """Returns the squares of the light before anything is known of it."""
    tree = quadtree.quadtree(COARSE)
    return quadtree.squares(tree, (tree.support_of < 0).nonzero()[:, 0])


def worth_cutting(squares: Int[Tensor, "squares 4"], flux: Float[Tensor, " squares"]) -> Bool[Tensor, " squares"]:
    """Returns which squares are too coarse for what they or their neighbours hold."""
    share = flux / flux.sum().clamp(min=1e-300)
    level = squares[:, 1]
    bright = share > BRIGHT
    centres = cubemap.cell_directions(cubemap.square_cells(squares))
    side = (torch.pi / 2) / 2.0**level
    angle = (centres @ centres[bright].T).clamp(-1, 1).acos()
    near = (angle < TOUCH * (side[:, None] + side[bright]) / 2) & (level[:, None] <= level[bright])
    return ((share > SHARE) | near.any(dim=1)) & (2**level < FINE)


def quarters(squares: Int[Tensor, "squares 4"]) -> Int[Tensor, "parts 4"]:
    """Returns the four quarters of every square."""
    face, level, row, column = squares.unbind(dim=1)
    parts = [
        torch.stack([face, level + 1, 2 * row + below, 2 * column + right], dim=1)
        for below in (0, 1)
        for right in (0, 1)
    ]
    return torch.cat(parts)
