"""Finite sets of functions in which light over a plane is expressed.

Every basis is a linear map S from coefficients to radiance at the visible texels of a cube map (`light.cubemap`),
and a transport over texels T becomes T S over coefficients. S can be applied, or asked for as a matrix where a solver
needs the constraint S c >= 0: non-negativity belongs to radiance, and only texels are radiance themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light import cubemap, haar
from torchlight.light.harmonics import real_spherical_harmonics

MAX_RESOLUTION = 512
MAX_DEGREE = 64
VALUES_PER_BLOCK = 4_000_000


@runtime_checkable
class Basis(Protocol):
    """A finite set of functions on the upper hemisphere."""

    @property
    def name(self) -> str:
        """What the command line and the results call it."""
        ...

    @property
    def resolution(self) -> int:
        """N of the N x N cube-map faces whose texels carry the transport."""
        ...

    @property
    def size(self) -> int:
        """Number of coefficients."""
        ...

    @property
    def nonnegative_coefficients(self) -> bool:
        """Whether non-negative radiance is the same as non-negative coefficients."""
        ...

    def analysis(self, texels: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns the coefficients of radiance given at the visible texels."""
        ...

    def synthesis(self, coefficients: Float[Tensor, "*batch coeffs"]) -> Float[Tensor, "*batch texels"]:
        """Returns the radiance S c at the visible texels."""
        ...

    def project(self, transport: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns T S, the transport over coefficients."""
        ...

    def synthesis_matrix(
        self, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
    ) -> Float[Tensor, "texels coeffs"] | None:
        """Returns S, or None where S = 1."""
        ...


@dataclass(frozen=True)
class Texels:
    """One coefficient per visible texel: its radiance.

    Attributes:
        resolution: N, a power of two from 1 to 512.
    """

    resolution: int

    def __post_init__(self) -> None:
        _check_resolution(self.resolution, smallest=1)

    @property
    def name(self) -> str:
        """The word "texels"."""
        return "texels"

    @property
    def size(self) -> int:
        """Number of visible texels: 3 N^2, or 5 for N = 1."""
        return cubemap.texel_count(self.resolution)

    @property
    def nonnegative_coefficients(self) -> bool:
        """True."""
        return True

    def analysis(self, texels: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch texels"]:
        """Returns its argument."""
        return texels

    def synthesis(self, coefficients: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch texels"]:
        """Returns its argument."""
        return coefficients

    def project(self, transport: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch texels"]:
        """Returns its argument."""
        return transport

    def synthesis_matrix(self, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> None:
        """Returns None: S = 1."""


@dataclass(frozen=True)
class SphericalHarmonics:
    """Real spherical harmonics up to a degree, (degree + 1)^2 coefficients.

    S holds each harmonic's average over each texel's visible part, weighted by max(0, z): what a transport of an
    unoccluded plane integrates. T S is therefore exact wherever visibility is constant within every texel.
    The averages are Gauss-Legendre sums, accurate to about 1e-12, made anew at each call.

    Attributes:
        degree: the largest l kept, 0 to 64.
        resolution: N, a power of two from 1 to 512.
    """

    degree: int
    resolution: int

    def __post_init__(self) -> None:
        _check_resolution(self.resolution, smallest=1)
        if not 0 <= self.degree <= MAX_DEGREE:
            raise ConfigError(f"degree: expected 0 to {MAX_DEGREE}, got {self.degree}; 4 or 5 is usual")

    @property
    def name(self) -> str:
        """The word "sh"."""
        return "sh"

    @property
    def size(self) -> int:
        """Number of coefficients, (degree + 1)^2."""
        return (self.degree + 1) ** 2

    @property
    def nonnegative_coefficients(self) -> bool:
        """False."""
        return False

    def analysis(self, texels: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns the integral of L Y over the sphere, for L constant on each texel and 0 below the plane.

        This is the best approximation over the whole sphere, not over the hemisphere: synthesis does not undo it.
        """
        return texels @ _harmonic_integrals(self, _one, device=texels.device).to(texels)

    def synthesis(self, coefficients: Float[Tensor, "*batch coeffs"]) -> Float[Tensor, "*batch texels"]:
        """Returns the cosine-weighted average over each visible texel of the light with these coefficients."""
        return coefficients @ self.synthesis_matrix(dtype=coefficients.dtype, device=coefficients.device).T

    def project(self, transport: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns T S, the transport over coefficients."""
        return transport @ self.synthesis_matrix(dtype=transport.dtype, device=transport.device)

    def synthesis_matrix(
        self, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
    ) -> Float[Tensor, "texels coeffs"]:
        """Returns S, the cosine-weighted average of each harmonic over each visible texel."""
        return _cosine_averages(self.degree, self.resolution, dtype, torch.device(device))


@dataclass(frozen=True)
class HaarCubemap:
    """Haar wavelets on the upper half of the cube map, orthonormal over unit face area (see `light.haar`).

    Attributes:
        resolution: N, a power of two from 2 to 512.
    """

    resolution: int

    def __post_init__(self) -> None:
        _check_resolution(self.resolution, smallest=2)

    @property
    def name(self) -> str:
        """The word "haar"."""
        return "haar"

    @property
    def size(self) -> int:
        """Number of coefficients, 3 N^2: as many as visible texels."""
        return cubemap.texel_count(self.resolution)

    @property
    def nonnegative_coefficients(self) -> bool:
        """False."""
        return False

    def analysis(self, texels: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns the coefficients, by a fast transform."""
        return haar.analysis(texels, self.resolution)

    def synthesis(self, coefficients: Float[Tensor, "*batch coeffs"]) -> Float[Tensor, "*batch texels"]:
        """Returns the radiance at the visible texels, by a fast transform; the inverse of `analysis`."""
        return haar.synthesis(coefficients, self.resolution)

    def project(self, transport: Float[Tensor, "*batch texels"]) -> Float[Tensor, "*batch coeffs"]:
        """Returns T S, by a fast transform."""
        return haar.project(transport, self.resolution)

    def synthesis_matrix(
        self, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
    ) -> Float[Tensor, "texels coeffs"]:
        """Returns S as a dense matrix, 9 N^4 numbers: for small resolutions only (0.6 GB at 64 in float32)."""
        return self.synthesis(torch.eye(self.size, dtype=dtype, device=device)).T.contiguous()


def _check_resolution(resolution: int, *, smallest: int) -> None:
    """Raises ConfigError unless the resolution is a power of two from the smallest to MAX_RESOLUTION."""
    if not smallest <= resolution <= MAX_RESOLUTION or resolution & (resolution - 1):
        raise ConfigError(
            f"resolution: expected a power of two from {smallest} to {MAX_RESOLUTION}, got {resolution}; 16 is usual"
        )


def _one(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Returns 1: the integral is over solid angle."""
    return torch.ones_like(directions[..., 2])


def _height(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Returns z, the cosine at the plane: the integral is over projected solid angle."""
    return directions[..., 2]


@torch.library.custom_op(  # opaque: a table, whose making has no place in a compiled graph
    "torchlight::cosine_averages",
    mutates_args=(),
    schema="(int degree, int resolution, ScalarType dtype, Device device) -> Tensor",
)
def _cosine_averages(degree: int, resolution: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Returns the cosine-weighted average of each harmonic over each visible texel [texels coeffs]."""
    sums = _harmonic_integrals(SphericalHarmonics(degree, resolution), _height, device=device)
    # Y_00 is constant, so its column holds the rule's own integral of the cosine: constants stay exact.
    return (sums / (sums[:, :1] * math.sqrt(4 * math.pi))).to(dtype)


@_cosine_averages.register_fake
def _(degree: int, resolution: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.empty(cubemap.texel_count(resolution), (degree + 1) ** 2, dtype=dtype, device=device)


def _harmonic_integrals(
    basis: SphericalHarmonics,
    density: Callable[[Float[Tensor, "*batch 3"]], Float[Tensor, "*batch"]],
    *,
    device: torch.device | str,
) -> Float[Tensor, "texels coeffs"]:
    """Returns the integral of density x Y over the visible part of each visible texel, in float64."""
    cells = cubemap.texel_cells(basis.resolution, device=device)
    directions, weights = (part[:, 0] for part in cubemap.gauss_nodes(cells, _nodes(basis)))
    weights = weights * density(directions)
    texels = max(1, VALUES_PER_BLOCK // (weights.shape[1] * basis.size))
    blocks = zip(directions.split(texels), weights.split(texels), strict=True)
    return torch.cat([_weighted_harmonics(basis.degree, *block) for block in blocks])


def _weighted_harmonics(
    degree: int, directions: Float[Tensor, "texels nodes 3"], weights: Float[Tensor, "texels nodes"]
) -> Float[Tensor, "texels coeffs"]:
    """Returns the weighted sum of each harmonic over the nodes of each texel."""
    return (weights[:, None, :] @ real_spherical_harmonics(degree, directions))[:, 0]


def _nodes(basis: SphericalHarmonics) -> int:
    """Returns the Gauss-Legendre nodes per axis that give about 1e-12.

    On a texel of half-width 1/N the integrand's nearest singularity, r = 0, lies N half-widths away in the complex
    plane, so n nodes converge as (N + sqrt(N^2 + 1))^(-2 n); a degree beyond a texel's size needs some more.
    """
    rate = 2 * math.asinh(basis.resolution)
    return 1 + math.ceil(30 / rate + basis.degree / basis.resolution)
