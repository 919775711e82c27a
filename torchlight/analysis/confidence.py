"""How far a recovered light can be trusted: what its photograph determines, and how far noise moves the rest.

Two answers, since there are two ways to be wrong:

- *observability* R_ii (`analysis.observability`): of structure as fine as a texel, independent from texel to texel,
  the share that the photograph determines. It depends on scene, mask and noise, not on what was found.
- *deviation* (`analysis.deviation`): how far the photograph's noise moves the radiance that was found. It is that of
  the mean radiance of each square (or texel) the light is made of; what varies within a square it does not know.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.analysis.deviation import damped_deviation, radiance_deviation, spanned_deviation
from torchlight.analysis.equations import (
    basis_equations,
    node_columns,
    observed_resolution,
    texel_equations,
)
from torchlight.analysis.observability import DETERMINED, texel_solid_angles
from torchlight.errors import ConfigError
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.leaf_program import dropped_wavelets
from torchlight.inversion.nodes import NodeColumns, product
from torchlight.inversion.quadtree import Quadtree, pyramid, quadtree, spread
from torchlight.inversion.refinement import needed
from torchlight.light import cubemap, haar, latlong
from torchlight.light.bases import Basis, HaarCubemap, Texels
from torchlight.photo.observation import Observation
from torchlight.solvers import Ridge, Solver
from torchlight.transfer import Transfer

UNKNOWN = 1e300  # stands for an infinite deviation in sums over nodes
ZERO = 1e-6  # of the largest radiance: held at 0
UNSEEN = 1e-6  # of the longest column: too little to be seen in any photograph


@dataclass(frozen=True, eq=False)
class Found:
    """A light and what it was found from: one photograph, in units of irradiance.

    Attributes:
        received: samples and weights.
        predicted: irradiance under the light.
        basis: what the coefficients multiply.
        solver: how they were found.
        coefficients: of the light.
        kept: functions in use, of the adaptive method; else None.
        noise: deviation of a sample, as a share of the brightest used.
    """

    received: Observation
    predicted: Float[Tensor, "channels points"]
    basis: Basis
    solver: Solver | AdaptiveHaar
    coefficients: Float[Tensor, "channels coeffs"]
    kept: Bool[Tensor, "channels coeffs"] | None
    noise: float

    @property
    def sigma(self) -> float:
        """Deviation of a sample of weight 1, in irradiance."""
        used = self.received.samples[:, self.received.weights > 0]
        return self.noise * (float(used.abs().max()) if used.numel() else 1.0)


@dataclass(frozen=True, eq=False)
class Confidence:
    """How far a light can be trusted.

    Attributes:
        observability: R_ii of every visible texel of a coarse cube map, 0 to 1.
        coarse: texels along its faces' edges.
        deviation: of the radiance of every visible texel, infinite where no sample sees it.
        seen: whether a texel of the coarse map reaches any sample that is used.
        resolution: texels along the edge of the deviation's cube map.
        noise: deviation of a sample, as a share of the brightest used.
    """

    observability: Float[Tensor, " texels"]
    coarse: int
    deviation: Float[Tensor, "channels fine"]
    seen: Bool[Tensor, " texels"]
    resolution: int
    noise: float

    @property
    def determined_share(self) -> float:
        """Part of the upper hemisphere's solid angle whose texels are determined: R_ii of at least one half."""
        angles = texel_solid_angles(self.coarse).to(self.observability)
        return float((angles * (self.observability >= DETERMINED)).sum() / angles.sum())

    @property
    def degrees_of_freedom(self) -> float:
        """Trace of R: how many numbers the photograph determines."""
        return float(self.observability.sum())

    def observability_map(self, height: int) -> Float[Tensor, "{height} {2*height}"]:
        """Returns R_ii of the texel that holds each pixel's centre; 0 below the plane."""
        return at_pixels(self.observability, self.coarse, height, 0.0)

    def deviation_map(self, height: int) -> Float[Tensor, "channels {height} {2*height}"]:
        """Returns the deviation of the square that holds each pixel's centre; infinite below the plane."""
        return at_pixels(self.deviation, self.resolution, height, torch.inf)

    def unseen_map(self, height: int) -> Bool[Tensor, "{height} {2*height}"]:
        """Returns the pixels about which the photograph says nothing: below the plane, or seen by no sample used."""
        return at_pixels((~self.seen).double(), self.coarse, height, 1.0) > 0.5


@torch.no_grad()
def confidence(columns: Transfer | NodeColumns, found: Found) -> Confidence:
    """Returns how far a light can be trusted.

    Args:
        columns: of its scene, those it was found with.
        found: the light.
    """
    weights = found.received.weights.detach().cpu().double()
    coarse = observed_resolution(columns)
    equations = texel_equations(columns, coarse)
    gram = equations.gram(weights)
    norms = gram.diagonal().clamp(min=0).sqrt()
    return Confidence(
        observability=equations.observability(weights, found.noise).float(),
        coarse=coarse,
        deviation=deviations(columns, found, weights).float(),
        seen=norms > UNSEEN * norms.max(),
        resolution=found.basis.resolution,
        noise=found.noise,
    )


def deviations(
    columns: Transfer | NodeColumns, found: Found, weights: Float[Tensor, " points"]
) -> Float[Tensor, "channels texels"]:
    """Returns the deviation of every texel's radiance, by the method that found it."""
    if isinstance(found.solver, AdaptiveHaar) and found.kept is not None:
        nodes = node_columns(columns, found.basis.resolution)
        return _of_squares(nodes, found, weights)
    if not isinstance(columns, Transfer):
        raise ConfigError(f"{type(found.solver).__name__} needs a dense transport; make it with precompute")
    if isinstance(found.basis, Texels | HaarCubemap):
        return _of_texels(columns, found, weights)
    return _of_functions(columns, found, weights)


def _of_texels(transfer: Transfer, found: Found, weights: Float[Tensor, " points"]) -> Float[Tensor, "channels texels"]:
    """Returns the deviations of texels. Whole Haar bases span them, and damp them alike: they are orthonormal."""
    equations = texel_equations(transfer, transfer.resolution)
    gram = equations.gram(weights)
    if isinstance(found.solver, Ridge):
        return damped_deviation(gram, found.solver.damping, found.sigma).expand(found.coefficients.shape[0], -1)
    radiance = found.basis.synthesis(found.coefficients.detach().cpu().double())
    slopes = (_residual(found) * weights) @ equations.columns.T
    both = zip(slopes, radiance, strict=True)
    return torch.stack([radiance_deviation(gram, slope, values, found.sigma) for slope, values in both])


def _of_functions(
    transfer: Transfer, found: Found, weights: Float[Tensor, " points"]
) -> Float[Tensor, "channels texels"]:
    """Returns the deviations of what few functions of the whole sky span."""
    equations, synthesis = basis_equations(transfer, found.basis)
    gram, sigma = equations.gram(weights), found.sigma
    if isinstance(found.solver, Ridge):
        return damped_deviation(gram, found.solver.damping, sigma, synthesis).expand(found.coefficients.shape[0], -1)
    synthesis = torch.eye(gram.shape[0], dtype=gram.dtype) if synthesis is None else synthesis
    radiance = found.coefficients.detach().cpu().double() @ synthesis.T
    held = radiance <= ZERO * radiance.amax(dim=-1, keepdim=True)
    return torch.stack([spanned_deviation(gram, synthesis, zeros, sigma) for zeros in held])


def _of_squares(
    nodes: NodeColumns, found: Found, weights: Float[Tensor, " points"]
) -> Float[Tensor, "channels texels"]:
    """Returns the deviations of the squares of every channel's tree, spread over their texels."""
    tree, root = quadtree(nodes.tree.resolution), weights.sqrt()  # on the CPU, wherever the columns are
    kept = torch.zeros(0, 0, dtype=torch.bool) if found.kept is None else found.kept.cpu()
    divided = [needed(tree, functions) for functions in kept]
    leaves = [tree.leaves(inner) for inner in divided]
    known = torch.unique(torch.cat(leaves))  # channels share most of their squares
    rows = nodes.of(known.to(nodes.dense.device)).cpu() * root
    gram, slopes = product(rows, rows), (_residual(found) * root) @ rows.T
    texels = haar.synthesis(found.coefficients.detach().cpu().double(), tree.resolution)
    values = square_means(tree, texels, known)
    whole = torch.zeros(kept.shape[0], tree.size, dtype=torch.float64)
    for channel, squares in enumerate(leaves):
        place = torch.searchsorted(known, squares)
        block, radiance = gram[place][:, place], values[channel, place]
        dropped = dropped_wavelets(tree, divided[channel], kept[channel])
        if dropped.shape[0] == 0:
            deviation = radiance_deviation(block, slopes[channel, place], radiance, found.sigma)
        else:  # the paper's rule leaves single wavelets out
            synthesis = wavelets_at(tree, squares, kept[channel])
            held = radiance <= ZERO * radiance.max()
            deviation = spanned_deviation(synthesis.T @ block @ synthesis, synthesis, held, found.sigma)
        whole[channel, squares] = deviation.nan_to_num(posinf=UNKNOWN)
    spread_out = spread(whole, tree.resolution)
    return torch.where(spread_out >= UNKNOWN, torch.inf, spread_out)


def square_means(
    tree: Quadtree, texels: Float[Tensor, "*batch texels"], squares: Int[Tensor, " squares"]
) -> Float[Tensor, "*batch squares"]:
    """Returns the mean over the texels of every square."""
    held = 4.0 ** (tree.level.max() - tree.level[squares]).double()
    return pyramid(texels, tree.resolution)[..., squares] / held


def wavelets_at(
    tree: Quadtree, squares: Int[Tensor, " squares"], kept: Bool[Tensor, " coeffs"]
) -> Float[Tensor, "squares kept"]:
    """Returns the value of every Haar function in use on every square, on which it is constant."""
    chosen = torch.eye(kept.shape[0], dtype=torch.float64)[kept]
    return square_means(tree, haar.synthesis(chosen, tree.resolution), squares).T


def _residual(found: Found) -> Float[Tensor, "channels points"]:
    left = found.received.samples.detach().cpu().double() - found.predicted.detach().cpu().double()
    return torch.where(found.received.weights.cpu() > 0, left, 0.0)


@functools.lru_cache(maxsize=4)
def pixel_texels(resolution: int, height: int) -> Int[Tensor, "upper columns"]:
    """Returns the visible texel that holds each pixel's centre, of the rows of a lat-long map above the plane."""
    index = cubemap.texel_index(latlong.pixel_directions(height)[: (height + 1) // 2], resolution)
    place = torch.full((6 * resolution**2,), -1)
    visible = cubemap.visible_texels(resolution)
    place[visible] = torch.arange(visible.shape[0])
    return place[index]


def at_pixels(
    values: Float[Tensor, "*batch texels"], resolution: int, height: int, below: float
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns the value of the texel that holds each pixel's centre, and `below` under the plane.

    Centres rather than areas: a mean of deviations is not the deviation of a mean.
    """
    index = pixel_texels(resolution, height)
    picture = values.new_full((*values.shape[:-1], height, 2 * height), below)
    upper = values[..., index.clamp(min=0)]
    picture[..., : index.shape[0], :] = torch.where(index >= 0, upper, below)
    return picture
