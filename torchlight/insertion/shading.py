"""How the new object throws light back: a diffuse part and a glossy lobe that together never give more than they get.

    f(l, v) = (1 - g) rho / pi + g D(h) G(l, v) / (4 (n.l) (n.v)),     h = (l + v) / |l + v|
    D(h)    = a^2 / (pi ((n.h)^2 (a^2 - 1) + 1)^2)
    G(l, v) = 2 (n.l) (n.v) / ((n.v) s(n.l) + (n.l) s(n.v)),           s(x) = sqrt(a^2 + (1 - a^2) x^2)

rho is the albedo, g the share of the glossy lobe, a its roughness (GGX; Walter et al. 2007; height-correlated masking,
Heitz 2014). The lobe throws back at most 1 of what it gets, so the whole at most (1 - g) rho + g <= 1. It is symmetric
in l and v. Not modelled: Fresnel's rise towards grazing angles, light between the facets, transmission.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError

SHARPEST = 0.05  # roughness: a lobe of about 6 degrees; below it, so many directions as the light has are too few


@dataclass(frozen=True)
class Material:
    """What the new object is made of.

    Attributes:
        albedo: rho, red, green and blue; of light that hits the diffuse part.
        gloss: g, the share of the glossy lobe.
        roughness: a, of the lobe; 0.1 is shiny, 0.5 is satin.
    """

    albedo: tuple[float, float, float] = (0.6, 0.6, 0.6)
    gloss: float = 0.0
    roughness: float = 0.3

    def __post_init__(self) -> None:
        if len(self.albedo) != 3 or not all(0.0 <= value < math.inf for value in self.albedo):
            raise ConfigError(f"albedo: expected three numbers of at least 0, got {list(self.albedo)}")
        if not 0.0 <= self.gloss <= 1.0:
            raise ConfigError(f"gloss: expected a share from 0 (diffuse) to 1, got {self.gloss:g}")
        if not SHARPEST <= self.roughness <= 1.0:
            raise ConfigError(
                f"roughness: expected {SHARPEST:g} to 1, got {self.roughness:g}; a sharper mirror is not rendered"
            )


def glossy(
    normals: Float[Tensor, "points 3"],
    toward: Float[Tensor, "points 3"],
    directions: Float[Tensor, "cells 3"],
    roughness: float,
) -> Float[Tensor, "points cells"]:
    """Returns the lobe times the cosine, D G / (4 n.v): what a point throws to the viewer of a power from a direction.

    Args:
        normals: n.
        toward: v, towards the viewer.
        directions: l, towards the light.
        roughness: a.
    """
    square = roughness**2
    n_v = (normals * toward).sum(dim=-1, keepdim=True).clamp(min=1e-4)
    n_l = (normals @ directions.T).clamp(min=0)
    half = (2 + 2 * toward @ directions.T).clamp(min=1e-12)  # |l + v|^2
    n_h = ((n_l + n_v).square() / half).clamp(max=1)  # squared
    facets = square / (math.pi * (n_h * (square - 1) + 1).square())
    masked = n_v * torch.sqrt(square + (1 - square) * n_l.square()) + n_l * torch.sqrt(
        square + (1 - square) * n_v.square()
    )
    return facets * n_l / (2 * masked)
