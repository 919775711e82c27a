"""Spheres of three materials under a light, seen from afar: a mirror, matte silver and a diffuse one.

The view is orthographic along a stated direction; the sphere touches the four edges of a square picture. A pixel at
(a, b) of the unit disc shows the normal n = a right + b up + sqrt(1 - a^2 - b^2) v, v being the direction towards the
viewer. Nothing but the light is reflected, and the sphere does not shade itself. A constant light L makes every pixel
of every sphere albedo L: exactly so for mirror and matte silver, to 2e-4 for the diffuse one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap, radiance_at
from torchlight.light_metrics.grid import first_moments, sample_weights

GGX_ROUGHNESS = 0.3271  # of the published matte silver; alpha is its square, as in Disney's and Blender's shaders
FINE = 64  # rows: coarser maps are cut up first, so that lobes and horizons are sampled well enough
VALUES_PER_CHUNK = 2**18  # 2 MB: stays in the cache
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class SphereView:
    """The pixels of a picture that show the sphere.

    Attributes:
        normals: of the sphere, in the world, in the order of the pixels inside.
        towards: unit vector to the viewer.
        inside: which pixels of the picture show the sphere; row 0 is its top.
    """

    normals: Float[Tensor, "pixels 3"]
    towards: Float[Tensor, "3"]
    inside: Bool[Tensor, "size size"]


def sphere_view(
    size: int,
    view: tuple[float, float, float],
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> SphereView:
    """Returns what each pixel of a picture of a sphere shows.

    Args:
        size: pixels along the picture's edge.
        view: from the sphere towards the viewer, of any length. World z is up; seen along z, world y is.
        dtype: of the vectors.
        device: of the vectors.

    Raises:
        ConfigError: no pixel, or no direction.
    """
    if size < 1:
        raise ConfigError(f"sphere size: expected at least 1 pixel, got {size}; 64 is usual")
    towards = torch.tensor(view, dtype=torch.float64)
    length = torch.linalg.vector_norm(towards)
    if not 0 < float(length) < math.inf:
        raise ConfigError(f"view: expected a direction from the sphere towards the viewer, got {view}")
    towards = towards / length
    above = torch.tensor(
        [0.0, 1.0, 0.0] if abs(float(towards[2])) > 1 - 1e-12 else [0.0, 0.0, 1.0], dtype=torch.float64
    )
    right = torch.nn.functional.normalize(torch.linalg.cross(above, towards), dim=0)
    up = torch.linalg.cross(towards, right)
    steps = (torch.arange(size, dtype=torch.float64) + 0.5) * (2 / size) - 1
    a, b = steps.expand(size, -1), -steps[:, None].expand(-1, size)
    inside = a * a + b * b < 1
    a, b = a[inside], b[inside]
    normals = a[:, None] * right + b[:, None] * up + (1 - a * a - b * b).sqrt()[:, None] * towards
    return SphereView(
        normals.to(dtype=dtype, device=device), towards.to(dtype=dtype, device=device), inside.to(device=device)
    )


def reflected(view: SphereView) -> Float[Tensor, "pixels 3"]:
    """Returns where each pixel's ray goes after a mirror: r = 2 (n . v) n - v."""
    return 2 * (view.normals @ view.towards)[:, None] * view.normals - view.towards


def mirror_sphere(environment: EnvironmentMap, view: SphereView) -> Float[Tensor, "*batch 3 pixels"]:
    """Returns L(r): the radiance of the map's pixel that each reflected ray meets."""
    return radiance_at(environment, reflected(view))


def diffuse_sphere(
    environment: EnvironmentMap, view: SphereView, progress: Progress | None = None
) -> Float[Tensor, "*batch 3 pixels"]:
    """Returns 1 / pi integral of L max(0, n . w) d omega.

    The integral of n . w over a pixel of the map is n . m with the exact first moment m: nothing is left out where the
    pixel lies on one side of the sphere's horizon. One that the horizon cuts counts as max(0, n . m).
    """
    radiance, height = _fine(environment)
    moments = first_moments(height, device=radiance.device)

    def weights(normals: Float[Tensor, "pixels 3"]) -> Float[Tensor, "pixels samples"]:
        return (normals @ moments.T).clamp_(min=0) / math.pi

    return _integrals(radiance, view.normals.double(), weights, progress)


def matte_sphere(
    environment: EnvironmentMap, view: SphereView, roughness: float = GGX_ROUGHNESS, progress: Progress | None = None
) -> Float[Tensor, "*batch 3 pixels"]:
    """Returns the mean of L under a GGX lobe: the integral of L f n . l over that of f n . l, without Fresnel's factor.

        f n . l = D(h) G(l, v) / (4 n . v),  h = (l + v) / |l + v|,  D = a^2 / (pi ((n . h)^2 (a^2 - 1) + 1)^2)
        G = 2 (n . l) (n . v) / ((n . v) sqrt(a^2 + (1 - a^2) (n . l)^2) + (n . l) sqrt(a^2 + (1 - a^2) (n . v)^2))

    with a = roughness^2, taken at the centres of the map's pixels.

    Raises:
        ConfigError: the roughness is not in (0, 1].

    References:
        Walter et al. (2007), Microfacet models for refraction through rough surfaces, eq. 33; Heitz (2014), eq. 99.
    """
    if not 0 < roughness <= 1:
        raise ConfigError(f"roughness: expected a number in (0, 1], got {roughness}; matte silver has {GGX_ROUGHNESS}")
    radiance, height = _fine(environment)
    directions = latlong.pixel_directions(height, device=radiance.device).reshape(-1, 3)
    angles = sample_weights(height, "sphere", device=radiance.device)
    towards = view.towards.double()
    half = torch.nn.functional.normalize(directions + towards, dim=-1)

    def weights(normals: Float[Tensor, "pixels 3"]) -> Float[Tensor, "pixels samples"]:
        lobe = ggx_lobe(normals @ directions.T, normals @ half.T, (normals @ towards)[:, None], roughness**2) * angles
        return lobe / lobe.sum(dim=-1, keepdim=True)

    return _integrals(radiance, view.normals.double(), weights, progress)


def ggx_lobe(
    n_l: Float[Tensor, "pixels samples"],
    n_h: Float[Tensor, "pixels samples"],
    n_v: Float[Tensor, "pixels 1"],
    alpha: float,
) -> Float[Tensor, "pixels samples"]:
    """Returns f n . l of `matte_sphere` up to a factor; 0 for light from behind."""
    square = alpha * alpha
    lit = n_l.clamp(min=0)
    spread = (n_h.square() * (square - 1) + 1).square_()
    shadowed = n_v * (square + (1 - square) * lit.square()).sqrt_()
    shadowed += lit * (square + (1 - square) * n_v.square()).sqrt()
    return lit / (spread * shadowed)


def picture(
    values: Float[Tensor, "*batch 3 pixels"], inside: Bool[Tensor, "size size"]
) -> Float[Tensor, "*batch 3 size size"]:
    """Returns the square picture of a sphere, 0 around it."""
    image = values.new_zeros(*values.shape[:-1], inside.numel())
    image[..., inside.flatten()] = values
    return image.unflatten(-1, inside.shape)


def _fine(environment: EnvironmentMap) -> tuple[Float[Tensor, "*batch 3 samples"], int]:
    """Returns the map in float64 on a grid of at least `FINE` rows: the same light, pixels cut into equal parts."""
    parts = math.ceil(FINE / environment.height)
    radiance = environment.radiance.double().repeat_interleave(parts, dim=-2).repeat_interleave(parts, dim=-1)
    return radiance.flatten(start_dim=-2), environment.height * parts


def _integrals(
    radiance: Float[Tensor, "*batch 3 samples"],
    normals: Float[Tensor, "pixels 3"],
    weights: Callable[[Tensor], Tensor],
    progress: Progress | None,
) -> Float[Tensor, "*batch 3 pixels"]:
    """Returns the sums of weight times radiance, some pixels at a time."""
    step = max(1, VALUES_PER_CHUNK // radiance.shape[-1])
    parts = []
    for start in range(0, len(normals), step):
        parts.append(radiance @ weights(normals[start : start + step]).T)
        if progress is not None:
            progress(min(start + step, len(normals)), len(normals))
    return torch.cat(parts, dim=-1)
