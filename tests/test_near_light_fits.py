"""Fits of light at a height: by products alone, they equal SciPy's on the samples."""

from __future__ import annotations

import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor

from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light import cubemap
from torchlight.near_light import fits, model
from torchlight.photo.reference import quadratic_terms
from torchlight.transfer import square_columns

RECEIVER = Receiver((0.0, 0.0), (240.0, 200.0), (24, 20))
SCENE = Scene(transform(box((40.0, 30.0, 45.0)), 1.0, (0.0, 0.0, 25.0), (-10.0, 5.0, 0.0)), RECEIVER)
CURVATURE = 1 / 400


def photographed(seed: int) -> tuple[Tensor, Tensor]:
    """Returns samples and weights: light from a few squares at a height, a fall-off, noise, some samples left out."""
    generator = torch.Generator().manual_seed(seed)
    shadow = model.shadow_of(SCENE, torch.ones(3, RECEIVER.points), torch.ones(RECEIVER.points))
    squares = model.coarse_squares()
    flux = torch.rand(len(squares), generator=generator, dtype=torch.float64).pow(8)
    values = direct(shadow, squares, CURVATURE) @ flux
    values = values * (1 + 0.1 * torch.randn(5, generator=generator, dtype=torch.float64) @ shadow.terms.T)
    values = values * (1 + 0.02 * torch.randn(len(values), generator=generator, dtype=torch.float64))
    kept, weights = torch.rand(2, len(values), generator=generator)
    weights = (kept > 0.2) * (0.5 + weights)
    return values.expand(3, -1), weights


def direct(shadow: model.Shadow, squares: Tensor, curvature: float) -> Tensor:
    """Returns the transport of squares at a height, one column per square, for a flux of 1, unweighted."""
    scene = model.stretched(SCENE, shadow.centre, curvature)
    columns = []
    for square in squares:
        count = max(fits.LEAST_DIRECTIONS, fits.DIRECTIONS // 2 ** int(square[1]))
        flux = cubemap.cell_cosine_weights(cubemap.square_cells(square[None]))
        columns.append(square_columns(scene, square[None], count)[0, shadow.used] / flux)
    return torch.stack(columns, dim=1)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_by_products_is_the_best_on_the_samples(seed: int) -> None:
    """min over f >= 0 and any a of |W^(1/2) (A f - v + diag(shown) Q a)|^2; SciPy takes a as a difference."""
    shadow = model.shadow_of(SCENE, *photographed(seed))
    squares, shown = model.coarse_squares(), 1 + 0.1 * torch.sin(torch.arange(len(shadow.values), dtype=torch.float64))
    found = fits.Heights(shadow, {}).best(squares, CURVATURE, shown)
    matrix = direct(shadow, squares, CURVATURE) * shadow.root[:, None]
    terms = quadratic_terms(sample_centers(RECEIVER))[shadow.used, 1:] * (shown * shadow.root)[:, None]
    _, norm = nnls(torch.cat([matrix, terms, -terms], dim=1).numpy(), (shadow.values * shadow.root).numpy())
    assert (found.flux >= 0).all()
    assert found.error == pytest.approx(norm**2, rel=1e-6)
    torch.testing.assert_close(found.shown, matrix @ found.flux / shadow.root)


def test_squares_asked_for_bit_by_bit_are_as_if_asked_for_at_once() -> None:
    shadow = model.shadow_of(SCENE, *photographed(0))
    squares, shown = model.coarse_squares(), torch.ones_like(shadow.values)
    parts, whole = fits.Heights(shadow, {}), fits.Heights(shadow, {})
    finer = torch.cat([squares[5:], model.quarters(squares[:5])])
    parts.best(squares[20:30], CURVATURE, shown)
    parts.best(squares, CURVATURE, shown)
    one, other = parts.best(finer, CURVATURE, shown), whole.best(finer, CURVATURE, shown)
    assert len(parts.known[CURVATURE].squares) == len(squares) + 20
    assert one.error == pytest.approx(other.error, rel=1e-7)
    torch.testing.assert_close(one.shown, other.shown, rtol=1e-3, atol=1e-3)
    again = parts.known[CURVATURE]
    parts.best(finer, CURVATURE, shown)
    assert parts.known[CURVATURE] is again  # nothing is cast twice
    torch.testing.assert_close(again.gram, again.rows @ again.rows.T)
    assert len(torch.unique(fits.keys(again.squares))) == len(again.squares)


def test_refined_squares_cover_the_same_light_and_fit_no_worse() -> None:
    shadow = model.shadow_of(SCENE, *photographed(1))
    squares, shown = model.coarse_squares(), torch.ones_like(shadow.values)
    heights = fits.Heights(shadow, {})
    finer, found = heights.refined(squares, CURVATURE, shown)
    area = cubemap.cell_solid_angles(cubemap.square_cells(finer)).sum()
    torch.testing.assert_close(area, cubemap.cell_solid_angles(cubemap.square_cells(squares)).sum())
    assert len(finer) > len(squares)
    assert found.error <= heights.best(squares, CURVATURE, shown).error * (1 + 1e-6)
    assert not model.worth_cutting(finer, found.flux).any()
