"""Light at a height, as distant light on a stretched object.

Let all light come from a plane z = h over the receiver. The projective map about the point c of the receiver

    M(x, y, z) = (c + ((x, y) - c) / (1 - k z),  z / (1 - k z)),     k = 1 / h,

leaves every point of z = 0 where it is, takes straight lines to straight lines, and sends the point c + h (u, v, 1) to
infinity in the direction (u, v, 1). So a triangle hides that point of the lamp from a sample exactly where the mapped
triangle hides the direction (u, v, 1): near light is distant light on a stretched object, and the transport of
`torchlight.transfer` serves for any height. k = 0 is distant light.

What a lamp's shadow tells of its height is therefore how much larger the upper parts of the object throw their shadow
than the lower ones: by the factor 1 / (1 - k z). The fall-off of a near lamp over the plane also tells, but so do
vignetting and uneven paper; it is no evidence here, and any smooth one is fitted and let go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.geometry.contours import scene_contours
from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.inversion import quadtree
from torchlight.light import cubemap
from torchlight.photo.reference import quadratic_terms
from torchlight.solvers import NNLS, LeastSquares
from torchlight.transfer import square_columns

COARSE = 4  # squares along a face's edge to begin with
FINE = 128  # and at most: 0.7 degrees
SHARE = 0.02  # of all flux: a square that holds more is cut into four
BRIGHT = 0.1  # of all flux: so are the neighbours of one that holds more, or a dark one might never get its turn
TOUCH = 1.1  # angle between centres of neighbours, in the mean of their sides
DIRECTIONS = 48  # along a face's edge,
LEAST_DIRECTIONS = 3  # and along a square's


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


@dataclass(frozen=True, eq=False)
class Fit:
    """The best light at one height.

    Attributes:
        flux: of every square.
        residual: observed less predicted, of every used sample, times the root of its weight, fall-off projected out.
        matrix: the transport in the same units.
        shown: predicted grey values.
        smooth: orthonormal basis of what a smooth fall-off can do to the prediction.
    """

    flux: Float[Tensor, " squares"]
    residual: Float[Tensor, " used"]
    matrix: Float[Tensor, "used squares"]
    shown: Float[Tensor, " used"]
    smooth: Float[Tensor, "used 5"]

    @property
    def error(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)


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
    corners = scene.triangles.double()
    factor = 1 / (1 - curvature * corners[..., 2:])
    plane = centre + (corners[..., :2] - centre) * factor
    return replace(scene, triangles=torch.cat([plane, corners[..., 2:] * factor], dim=-1))


def columns(shadow: Shadow, squares: Int[Tensor, "squares 4"], curvature: float) -> Float[Tensor, "used squares"]:
    """Returns what squares of light at a height show on the used samples, for a flux of 1 each."""
    scene = stretched(shadow.scene, shadow.centre, curvature)
    result = torch.empty(len(squares), int(shadow.used.sum()), dtype=torch.float64)
    contours = scene_contours(scene)
    for level in squares[:, 1].unique().tolist():
        alike = squares[:, 1] == level
        directions = max(LEAST_DIRECTIONS, DIRECTIONS // 2**level)
        result[alike] = square_columns(scene, squares[alike], directions, contours)[:, shadow.used]
    weights = cubemap.cell_cosine_weights(cubemap.square_cells(squares))
    return (result / weights[:, None]).T


def fit(shadow: Shadow, matrix: Float[Tensor, "used squares"], shown: Float[Tensor, " used"]) -> Fit:
    """Returns the non-negative light that explains the photograph but for a smooth fall-off.

    min |W^(1/2) (A f - v + diag(shown) Q a)|^2 over f >= 0 and any a: Q a is the fall-off, quadratic in x and y.

    Args:
        shadow: the photograph.
        matrix: A, from `columns`.
        shown: a prediction to begin with, of which the fall-off is a factor.
    """
    smooth, _ = torch.linalg.qr(shadow.terms * (shown * shadow.root)[:, None])
    weighted, target = matrix * shadow.root[:, None], shadow.values * shadow.root
    weighted = weighted - smooth @ (smooth.T @ weighted)
    target = target - smooth @ (smooth.T @ target)
    flux = NNLS(tolerance=1e-7).solve(LeastSquares(weighted, target[None])).coefficients[0]
    return Fit(flux, target - weighted @ flux, weighted, matrix @ flux, smooth)


def coarse_squares() -> Int[Tensor, "squares 4"]:
    """Returns the squares of the light before anything is known of it."""
    tree = quadtree.quadtree(COARSE)
    return quadtree.squares(tree, (tree.support_of < 0).nonzero()[:, 0])


def refined(
    shadow: Shadow, squares: Int[Tensor, "squares 4"], shown: Float[Tensor, " used"], curvature: float
) -> tuple[Int[Tensor, "more 4"], Fit]:
    """Returns squares of which none that could be cut holds more than a fiftieth of the flux, and the fit."""
    matrix = columns(shadow, squares, curvature)
    while True:
        found = fit(shadow, matrix, shown)
        cut = worth_cutting(squares, found.flux)
        if not bool(cut.any()):
            return squares, found
        parts = quarters(squares[cut])
        squares = torch.cat([squares[~cut], parts])
        matrix = torch.cat([matrix[:, ~cut], columns(shadow, parts, curvature)], dim=1)
        shown = found.shown


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
