"""One lamp from several photographs: exact directions meet at it, parallel ones nowhere."""

from __future__ import annotations

import math

import pytest
import torch

from torchlight.errors import SceneError, ShapeError
from torchlight.near_light.triangulation import triangulate

PLACES = torch.tensor([[0.0, 0.0], [200.0, 10.0], [30.0, 150.0], [180.0, 160.0]], dtype=torch.float64)
LAMP = torch.tensor([210.0, -150.0, 490.0], dtype=torch.float64)


def on_plane(places: torch.Tensor) -> torch.Tensor:
    return torch.cat([places, torch.zeros_like(places[:, :1])], dim=1)


def test_exact_directions_meet_at_the_lamp() -> None:
    directions = LAMP - on_plane(PLACES)
    found = triangulate(PLACES, directions)
    torch.testing.assert_close(found.position, LAMP)
    unit = torch.nn.functional.normalize(directions, dim=-1)
    drift = math.degrees(float((unit @ unit.T).clamp(-1, 1).acos().max()))
    assert found.drift_degrees == pytest.approx(drift)
    assert found.residual_degrees < 1e-4
    assert found.flagged


def test_of_a_hundred_distant_lights_about_one_is_called_near() -> None:
    generator = torch.Generator().manual_seed(0)
    alarms = 0
    for _ in range(1000):
        noise = 0.02 * torch.randn(4, 2, generator=generator, dtype=torch.float64)
        tangents = torch.tensor([0.3, -0.5], dtype=torch.float64) + noise
        alarms += triangulate(PLACES, torch.cat([tangents, torch.ones(4, 1, dtype=torch.float64)], dim=1)).flagged
    assert 3 <= alarms <= 20  # of 1000; 10 expected, deviation 3.1


def test_directions_that_spread_apart_are_distant() -> None:
    found = triangulate(PLACES, on_plane(PLACES) + torch.tensor([0.0, 0.0, 490.0], dtype=torch.float64))
    assert not found.flagged
    assert found.drift_degrees == 0
    assert not bool(found.position[2].isfinite())


def test_what_cannot_be_triangulated_is_one_line() -> None:
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(4, 3)
    with pytest.raises(SceneError, match="one place"):
        triangulate(torch.zeros(4, 2), up)
    with pytest.raises(ShapeError, match="3 directions"):
        triangulate(PLACES[:2], up[:2])
    with pytest.raises(SceneError, match="not above"):
        triangulate(PLACES, -up)
