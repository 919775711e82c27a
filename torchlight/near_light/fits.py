"""The best light at a height, found again and again: for other squares of light, for another fall-off.

Let a_j be what square j of light shows on the samples for a flux of 1 and t the photograph, both times the roots of the
weights. A smooth fall-off can do to the prediction what the orthonormal columns of S do, and is let go:

    R = min over f >= 0 and any a of |A f - t + S a|^2
      = min over f >= 0 of f' (A'A - B'B) f - 2 f' (A't - B'S't) + |t|^2 - |S't|^2,      B = S'A.

A'A and A't are kept for each height while squares are added to A; a fit is then a problem of the size of the squares,
however many samples there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.geometry.contours import Contours, scene_contours
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.near_light.model import FINE, Shadow, quarters, stretched, worth_cutting
from torchlight.solvers.active_set import Limits
from torchlight.solvers.batch import minimize
from torchlight.solvers.shared_gram import unit_gram
from torchlight.transfer import square_columns

DIRECTIONS = 48  # along a face's edge,
LEAST_DIRECTIONS = 3  # and along a square's
RIDGE = 1e-12  # of the unit diagonal of A'A - B'B: what is less is rounding
LIMITS = Limits(tolerance=1e-10, max_steps=5000)

Squares = Int[Tensor, "squares 4"]
MoreSquares = Int[Tensor, "more 4"]


@dataclass(frozen=True, eq=False)
class Height:
    """What squares of light at one height show of an object.

    Attributes:
        scene: the object stretched, for which that light is distant.
        contours: of its shadow.
        squares: of light that were asked for so far.
        rows: a_j, one row per square.
        gram: A'A.
        linear: A't.
    """

    scene: Scene
    contours: Contours
    squares: Squares
    rows: Float[Tensor, "squares used"]
    gram: Float[Tensor, "squares squares"]
    linear: Float[Tensor, " squares"]


@dataclass(frozen=True, eq=False)
class Fit:
    """The best light at one height.

    Attributes:
        flux: of every square.
        shown: predicted grey values.
        error: R, the sum of squared residuals.
    """

    flux: Float[Tensor, " squares"]
    shown: Float[Tensor, " used"]
    error: float


@dataclass(frozen=True, eq=False)
class Heights:
    """A photograph, and what is known of light at some heights: squares that are asked for again are not cast again.

    Attributes:
        shadow: the photograph.
        known: by curvature k = 1 / height.
    """

    shadow: Shadow
    known: dict[float, Height]

    def best(self, squares: Squares, curvature: float, shown: Float[Tensor, " used"]) -> Fit:
        """Returns the best light of some squares at a height.

        Args:
            squares: (face, level, row, column) each.
            curvature: k.
            shown: a prediction to begin with, of which the fall-off is a factor.
        """
        height = self.known.get(curvature)
        height = unasked(self.shadow, curvature) if height is None else height
        height = self.known[curvature] = asked(self.shadow, height, squares)
        return fit(self.shadow, height, places(height.squares, squares), shown)

    def refined(self, squares: Squares, curvature: float, shown: Float[Tensor, " used"]) -> tuple[MoreSquares, Fit]:
        """Returns squares of which none that could be cut holds more than a fiftieth of the flux, and the fit."""
        while True:
            found = self.best(squares, curvature, shown)
            cut = worth_cutting(squares, found.flux)
            if not bool(cut.any()):
                return squares, found
            squares, shown = torch.cat([squares[~cut], quarters(squares[cut])]), found.shown


def unasked(shadow: Shadow, curvature: float) -> Height:
    """Returns a height of which nothing is known yet."""
    scene = stretched(shadow.scene, shadow.centre, curvature)
    none = torch.zeros(0, len(shadow.values), dtype=torch.float64)
    squares = torch.zeros(0, 4, dtype=torch.int64)
    return Height(scene, scene_contours(scene), squares, none, none @ none.T, none[:, 0])


def asked(shadow: Shadow, height: Height, squares: MoreSquares) -> Height:
    """Returns the height with those of the squares that it lacks."""
    lacking = squares[~torch.isin(keys(squares), keys(height.squares))]
    if len(lacking) == 0:
        return height
    new = cast(shadow, height, lacking)
    rows = torch.cat([height.rows, new])
    across = rows @ new.T
    gram = across.new_empty(len(rows), len(rows))
    gram[: len(height.rows), : len(height.rows)] = height.gram
    gram[:, len(height.rows) :], gram[len(height.rows) :] = across, across.T
    linear = torch.cat([height.linear, new @ (shadow.values * shadow.root)])
    return Height(height.scene, height.contours, torch.cat([height.squares, lacking]), rows, gram, linear)


def cast(shadow: Shadow, height: Height, squares: Squares) -> Float[Tensor, "squares used"]:
    """Returns what squares show on the used samples for a flux of 1 each, times the roots of the weights."""
    result = torch.empty(len(squares), len(shadow.values), dtype=torch.float64)
    flux = cubemap.cell_cosine_weights(cubemap.square_cells(squares))
    used = shadow.used.nonzero()[:, 0]
    counts = torch.clamp(DIRECTIONS // 2 ** squares[:, 1], min=LEAST_DIRECTIONS)
    for count in counts.unique().tolist():
        alike = counts == count
        shown = square_columns(height.scene, squares[alike], count, height.contours)
        result[alike] = shown.index_select(1, used) / flux[alike, None]
    return result.mul_(shadow.root)


def places(known: Int[Tensor, "known 4"], squares: Squares) -> Int[Tensor, " squares"]:
    """Returns where each of the squares stands among known ones."""
    order = keys(known).argsort()
    return order[torch.searchsorted(keys(known)[order], keys(squares))]


def keys(squares: Squares) -> Int[Tensor, " squares"]:
    """Returns a number for each square, its own."""
    face, level, row, column = squares.unbind(dim=1)
    return ((face * 64 + level) * FINE + row) * FINE + column


def fit(shadow: Shadow, height: Height, chosen: Int[Tensor, " squares"], shown: Float[Tensor, " used"]) -> Fit:
    """Returns the non-negative light of chosen squares that explains the photograph but for a smooth fall-off."""
    target = shadow.values * shadow.root
    smooth, _ = torch.linalg.qr(shadow.terms * (shown * shadow.root)[:, None])
    let_go = (smooth.T @ height.rows.T)[:, chosen]
    kept = smooth.T @ target
    gram = height.gram[chosen][:, chosen] - let_go.T @ let_go
    linear = height.linear[chosen] - let_go.T @ kept
    flux = least(gram, linear)
    weighted = torch.zeros(len(height.rows), dtype=torch.float64).index_put((chosen,), flux) @ height.rows
    residual = target - weighted
    error = float(residual @ residual - (smooth.T @ residual).square().sum())
    return Fit(flux, weighted / shadow.root, error)


def least(gram: Float[Tensor, "n n"], linear: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Returns the least f' G f / 2 - c' f over f >= 0."""
    unit = unit_gram(gram)
    scaled = linear * unit.inverse
    size = scaled.max().clamp(min=1e-300)
    found, _ = minimize(unit, (scaled / size)[None], torch.zeros_like(scaled)[None], RIDGE, LIMITS)
    return found[0] * size * unit.inverse
