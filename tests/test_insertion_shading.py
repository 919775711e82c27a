"""What the object throws back: energy, symmetry, the written formula."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.insertion.shading import Material, glossy
from torchlight.light.directions import from_angles

UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)


def unit(count: int, seed: int) -> Tensor:
    draw = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    draw[:, 2] = draw[:, 2].abs() + 0.05
    return torch.nn.functional.normalize(draw, dim=-1)


def written(normal: Tensor, toward: Tensor, light: Tensor, a: float) -> float:
    """The formula of the module, number by number."""
    half = (light + toward) / (light + toward).norm()
    nl, nv, nh = (float(normal @ v) for v in (light, toward, half))
    d = a**2 / (math.pi * (nh**2 * (a**2 - 1) + 1) ** 2)

    def s(x: float) -> float:
        return math.sqrt(a**2 + (1 - a**2) * x**2)

    return d * (2 * nl * nv / (nv * s(nl) + nl * s(nv))) / (4 * nl * nv) * nl


def test_the_lobe_is_the_formula() -> None:
    toward, light = unit(5, 1), unit(7, 2)
    found = glossy(UP.expand(5, 3), toward, light, 0.35)
    expected = [[written(UP[0], v, l, 0.35) for l in light] for v in toward]
    assert_close(found, torch.tensor(expected, dtype=torch.float64))


def test_the_lobe_is_symmetric() -> None:
    toward, light = unit(4, 3), unit(4, 4)
    forth = torch.stack([glossy(UP, v[None], l[None], 0.2)[0, 0] / l[2] for v, l in zip(toward, light, strict=True)])
    back = torch.stack([glossy(UP, l[None], v[None], 0.2)[0, 0] / v[2] for v, l in zip(toward, light, strict=True)])
    assert_close(forth, back)


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("slant_degrees", [0.0, 50.0, 85.0])
def test_the_lobe_never_throws_back_more_than_it_gets(roughness: float, slant_degrees: float) -> None:
    # white furnace: the integral of the lobe over all light of radiance 1, by a fine grid of directions
    count = 600
    cosine = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    phi = (torch.arange(2 * count, dtype=torch.float64) + 0.5) * (math.pi / count)
    light = from_angles(torch.acos(cosine)[:, None], phi[None]).reshape(-1, 3)
    slant = torch.tensor(math.radians(slant_degrees), dtype=torch.float64)
    toward = torch.stack([slant.sin(), slant * 0, slant.cos()])[None]
    total = glossy(UP, toward, light, roughness).sum().item() * math.pi / count / count
    assert 0.3 < total < 1.0 + 1e-3
    if slant_degrees == 0.0:
        assert_close(total, kept_seen_from_above(roughness), rtol=0, atol=2e-3)


def kept_seen_from_above(a: float) -> float:
    """The same integral at v = n, over facets: tan^2 = a^2 u / (1 - u), light mirrored to twice the angle."""
    u = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 200_000
    square = a**2 * u / (1 - u)
    nl = ((1 - square) / (1 + square)).clamp(min=0)
    return (2 * nl / (torch.sqrt(a**2 + (1 - a**2) * nl**2) + nl)).mean().item()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"albedo": (0.5, -0.1, 0.5)}, "albedo: expected three numbers of at least 0"),
        ({"albedo": (0.5, math.nan, 0.5)}, "albedo"),
        ({"gloss": 1.5}, "gloss: expected a share from 0"),
        ({"gloss": math.nan}, "gloss"),
        ({"roughness": 0.01}, "a sharper mirror is not rendered"),
    ],
)
def test_materials_that_cannot_be(wrong: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Material(**wrong)
