"""The light that surfaces facing any way should be shaded with: even wherever the photograph does not tell.

Light from near the horizon hardly reaches the plane, by the cosine, and reaches upright surfaces in full: of it the
photograph says little, while an inserted object shows it. Least squares leaves it anywhere between 0 and many times
what is usual. Here, of radiances x > 0 of the texels of a coarse cube map, the most probable given the photograph

    Q(x) = |A x - b|^2 / 2 s^2 + sum over scales j of alpha_j D_j(x) / l
    D_j  = sum over squares q of scale j of a_q x_q ln(x_q / x_parent(q))

is taken, with s the noise, a solid angles as shares of the hemisphere, x_q the mean over a square, l the mean light (by
the plane's irradiance) and the parent of the coarsest squares an even sky l. D_j is the relative entropy of the light
against light that is even within the squares a scale coarser: 0 where it is, and growing with the contrast only, so
that a sun costs no more than its share of the light. With equal alpha the sum is the relative entropy against the even
sky, the prior of maximum entropy (Gull and Daniell 1978; Skilling 1989).

How much evenness counts, alpha, is read off the photograph itself: where the evidence is largest (Gull 1989),

    2 alpha D / l = number of facts that the photograph tells of that scale = dim - alpha trace(H^-1 D'' / l)

with H the Hessian of Q. One alpha for all scales says: light is alike everywhere, and what nothing tells of is as
bright as the sky on average. One for each scale says: light is like its surroundings. Photographs do not tell which of
the two holds where they tell nothing, and probes are of both kinds; `even_light` is the mean of the two, the estimate
of least square error where either is as likely.

References:
    S. F. Gull and G. J. Daniell, "Image reconstruction from incomplete and noisy data", Nature 272, 1978.
    S. F. Gull, "Developments in maximum entropy data analysis", in: Maximum Entropy and Bayesian Methods, 1989.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.analysis.observability import texel_solid_angles
from torchlight.light import cubemap

COARSEST = 2  # texels along a face's edge at the coarsest scale: an eighth of the sky each, about
FIRST_ALPHA = 60.0
ALPHAS = (1e-2, 1e5)
STEPS = 60
SETTLED = 2e-3  # of the brightest texel
ALPHA_SETTLED = 0.05
AFTER = 5  # Newton steps before alpha is read off
REACH = 5.0  # a Newton step changes no radiance by more than this factor
LEAST = 1e-9  # D, and the mean diagonal that is added to H: rounding


@dataclass(frozen=True, eq=False)
class Facts:
    """What a photograph says of one channel's texels, to second order round a light that explains it.

    |A x - b|^2 / s^2 = (x - start)' gram (x - start) - 2 slopes' (x - start) + constant

    Attributes:
        gram: A'W A / s^2.
        slopes: A'W (b - A start) / s^2.
        start: the light that was found, mean radiance of every texel.
        level: l, the radiance of the even sky that lights the plane as much.
    """

    gram: Float[Tensor, "n n"]
    slopes: Float[Tensor, " n"]
    start: Float[Tensor, " n"]
    level: float


@dataclass(frozen=True, eq=False)
class Scales:
    """Squares of the cube map from coarse to fine, the texels last.

    Attributes:
        square: of every scale, the number of the square that holds each texel.
        counts: number of squares of every scale.
        areas: a, of the texels, shares of the hemisphere.
        together: of every scale a_i a_k where one square holds both texels, else 0.
    """

    square: tuple[Int[Tensor, " n"], ...]
    counts: tuple[int, ...]
    areas: Float[Tensor, " n"]
    together: tuple[Float[Tensor, "n n"], ...]

    @property
    def dimensions(self) -> list[int]:
        """Returns of every scale how many numbers it has beside those of the coarser ones."""
        return [count - before for count, before in zip(self.counts, (0, *self.counts[:-1]), strict=True)]

    def sums(self, values: Float[Tensor, " n"], scale: int) -> Float[Tensor, " n"]:
        """Returns of every texel the sum over its square."""
        totals = values.new_zeros(self.counts[scale]).index_add_(0, self.square[scale], values)
        return totals[self.square[scale]]


@functools.lru_cache(maxsize=4)
def scales_of(resolution: int) -> Scales:
    """Returns the scales of a cube map, each of half the texels along an edge of the next; a power of two from 2."""
    chain, size = [torch.arange(cubemap.texel_count(resolution))], resolution
    while size > COARSEST:
        chain.insert(0, _parents(size)[chain[0]])
        size //= 2
    areas = texel_solid_angles(resolution).double()
    areas /= areas.sum()
    together = tuple((squares[:, None] == squares) * (areas[:, None] * areas) for squares in chain)
    return Scales(tuple(chain), tuple(int(squares.max()) + 1 for squares in chain), areas, together)


def even_light(facts: Facts, scales: Scales) -> Float[Tensor, " n"]:
    """Returns the mean of the light that is alike everywhere and the light that is like its surroundings.

    The light that was found where the channel is black.
    """
    if not facts.level > 0:
        return facts.start
    count = len(scales.counts)
    kinds = (tuple([0] * count), tuple(range(count)))
    return torch.stack([evenest(facts, scales, shared)[0] for shared in kinds]).mean(dim=0)


def evenest(
    facts: Facts, scales: Scales, shared: tuple[int, ...]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " alphas"]]:
    """Returns the minimum of Q and the alphas at which the evidence is largest.

    Newton's method in the metric of the entropy, no radiance changed by more than a factor at once; Q is convex.

    Args:
        facts: of a channel that is not black.
        scales: of its texels.
        shared: for every scale, the number of its alpha.
    """
    x = (facts.start.clamp(min=0) + facts.level) / 2
    alphas = x.new_full((max(shared) + 1,), FIRST_ALPHA)
    place = torch.tensor(shared)
    for step in range(STEPS):
        gradients, entropies = unevenness(x, scales, facts.level)
        curved = bends(x, scales, facts.level)
        gradient = facts.gram @ (x - facts.start) - facts.slopes + alphas[place] @ gradients
        hessian = facts.gram + sum(alphas[place[j]] * bend for j, bend in enumerate(curved))
        root = x.sqrt()
        scaled = hessian * root[:, None] * root
        scaled.diagonal().add_(LEAST * scaled.diagonal().mean())
        factor = torch.linalg.cholesky(scaled)
        change = -torch.cholesky_solve((gradient * root)[:, None], factor)[:, 0] * root
        moved = (x + change).maximum(x / REACH).minimum(x * REACH)
        settled = float((moved - x).abs().max()) < SETTLED * float(moved.max())
        x = moved
        if step < AFTER or step % 2 == 0:
            continue
        inverse = torch.cholesky_inverse(factor) * root[:, None] * root
        spread = torch.stack([(inverse * bend).sum() for bend in curved])
        better = _evidence(alphas, entropies, spread, scales, place)
        steady = float((better / alphas - 1).abs().max()) < ALPHA_SETTLED
        alphas = better
        if settled and steady:
            break
    return x, alphas


def _evidence(
    alphas: Float[Tensor, " alphas"],
    entropies: Float[Tensor, " scales"],
    spread: Float[Tensor, " scales"],
    scales: Scales,
    place: Int[Tensor, " scales"],
) -> Float[Tensor, " alphas"]:
    """Returns alpha = facts told / 2 D, both summed over the scales that share it."""
    told = torch.tensor(scales.dimensions).to(alphas) - alphas[place] * spread
    facts, uneven = (torch.zeros_like(alphas).index_add_(0, place, values) for values in (told, entropies))
    return (facts.clamp(min=LEAST) / (2 * uneven.clamp(min=LEAST))).clamp(*ALPHAS)


def unevenness(
    x: Float[Tensor, " n"], scales: Scales, level: float
) -> tuple[Float[Tensor, "scales n"], Float[Tensor, " scales"]]:
    """Returns the gradients of D_j / l, and D_j / l; of the coarsest squares with l - x_q added, so that it is >= 0."""
    a = scales.areas
    means = [scales.sums(a * x, j) / scales.sums(a, j) for j in range(len(scales.counts))]
    logs = torch.stack([mean.log() for mean in means])
    above = torch.cat([torch.full_like(logs[:1], level).log(), logs[:-1]])
    gradients = a * (logs - above) / level
    entropies = gradients @ x
    entropies[0] += (a * (level - x)).sum() / level
    return gradients, entropies


def bends(x: Float[Tensor, " n"], scales: Scales, level: float) -> list[Float[Tensor, "n n"]]:
    """Returns the second derivatives of D_j / l: a_i a_k (1 / a_q x_q where a square holds both, less its parent's)."""
    a = scales.areas
    result, before = [], x.new_zeros(())
    for j, together in enumerate(scales.together):
        own = together * (1 / scales.sums(a * x, j) / level)[:, None]
        result.append(own - before)
        before = own
    return result


def _parents(size: int) -> Int[Tensor, " n"]:
    """Returns the texel of half as many along an edge that holds each, both by their place among the visible ones."""
    index = cubemap.visible_texels(size)
    face, row, column = index // size**2, index // size % size, index % size
    half = size // 2
    coarse = (face * half + row // 2) * half + column // 2
    return torch.searchsorted(cubemap.visible_texels(half), coarse)
