"""Near light: the map's closed form, and a test that knows lamps from distant light in photographs it did not make."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchlight.geometry.footprints import footprint_points
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, receiver_corners
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.geometry.visibility import scene_occlusion
from torchlight.near_light import model
from torchlight.near_light.verdict import near_light
from torchlight.photo.observation import Observation

RECEIVER = Receiver((0.0, 0.0), (240.0, 240.0), (40, 40))
BLOCK = transform(box((40.0, 30.0, 45.0)), 1.0, (0.0, 0.0, 25.0), (-10.0, 5.0, 0.0))
SCENE = Scene(BLOCK, RECEIVER)
TOWARDS = torch.nn.functional.normalize(torch.tensor([0.55, -0.4, 0.75], dtype=torch.float64), dim=-1)
SUBPOINTS = 4


def photographed(lamp: Tensor, radius: float, seed: int = 0) -> Observation:
    """Returns the plane under a ball of light in a grey sky, by rays from every footprint to points of the ball."""
    generator = torch.Generator().manual_seed(seed)
    points = footprint_points(RECEIVER, SUBPOINTS).reshape(-1, 3)
    test = scene_occlusion(SCENE)
    values = torch.zeros(len(points), dtype=torch.float64)
    for _ in range(24):
        offset = torch.randn(3, generator=generator, dtype=torch.float64)
        place = lamp + radius * offset / offset.norm()
        ray = place - points
        falloff = ray[:, 2] / ray.norm(dim=1) ** 3
        hidden = torch.from_numpy(test.hidden_from(place.numpy(), points.numpy()))
        values += torch.where(hidden, 0.0, falloff)
    values = values.reshape(RECEIVER.points, -1).mean(dim=1)
    values = values / values.mean() + 0.25
    noisy = values * (1 + 0.01 * torch.randn(RECEIVER.points, generator=generator, dtype=torch.float64))
    inside = torch.from_numpy(
        test.hidden(points.numpy(), torch.tensor([[0.0, 0.0, 1.0]]).expand(len(points), 3).numpy())
    )
    weights = (~inside.reshape(RECEIVER.points, -1).any(dim=1)).double()
    return Observation(noisy.expand(3, -1), weights)


def drift(lamp: Tensor) -> float:
    towards = torch.nn.functional.normalize(lamp - receiver_corners(RECEIVER), dim=-1)
    return math.degrees(float((towards @ towards.T).clamp(-1, 1).acos().max()))


def test_the_map_sends_the_lamp_to_infinity_and_keeps_the_plane() -> None:
    """A ray from a plane point to the lamp becomes a ray in the one direction (u, v, 1), through the mapped points."""
    height, centre = 300.0, torch.tensor([7.0, -3.0], dtype=torch.float64)
    direction = torch.tensor([0.4, -0.9, 1.0], dtype=torch.float64)
    lamp = torch.cat([centre, torch.zeros(1, dtype=torch.float64)]) + height * direction
    start = torch.tensor([[50.0, 20.0, 0.0], [-30.0, 80.0, 0.0], [11.0, -40.0, 0.0]], dtype=torch.float64)
    along = start + torch.tensor([[0.1], [0.3], [0.6]], dtype=torch.float64) * (lamp - start)
    mapped = model.stretched(replace(SCENE, triangles=torch.stack([start, along])), centre, 1 / height).triangles
    torch.testing.assert_close(mapped[0], start)
    torch.testing.assert_close(torch.linalg.cross(mapped[1] - start, direction.expand(3, 3)), torch.zeros_like(start))


def test_distant_light_leaves_the_object_alone() -> None:
    torch.testing.assert_close(model.stretched(SCENE, torch.zeros(2, dtype=torch.float64), 0.0).triangles, BLOCK)


def test_a_lamp_is_flagged_with_its_drift() -> None:
    lamp = 600.0 * TOWARDS
    verdict = near_light(SCENE, photographed(lamp, 12.0))
    assert verdict is not None
    assert verdict.flagged
    assert verdict.drift_degrees == pytest.approx(drift(lamp), rel=0.3)
    assert verdict.distance == pytest.approx(600.0, rel=0.3)


def test_the_same_lamp_far_away_is_not() -> None:
    verdict = near_light(SCENE, photographed(200 * 600.0 * TOWARDS, 200 * 12.0))
    assert verdict is not None
    assert not verdict.flagged


def test_fall_off_alone_is_no_evidence() -> None:
    distant = photographed(200 * 600.0 * TOWARDS, 200 * 12.0)
    x = torch.linspace(0.8, 1.2, RECEIVER.samples[0], dtype=torch.float64).repeat(RECEIVER.samples[1])
    verdict = near_light(SCENE, replace(distant, samples=distant.samples * x))
    assert verdict is not None
    assert not verdict.flagged


def test_brightness_plays_no_part() -> None:
    observation = photographed(600.0 * TOWARDS, 12.0)
    one, other = (near_light(SCENE, replace(observation, samples=observation.samples * scale)) for scale in (1, 1e-3))
    assert one is not None
    assert other is not None
    assert other.drift_degrees == pytest.approx(one.drift_degrees, rel=1e-6)


def test_what_tells_nothing_is_none() -> None:
    observation = photographed(600.0 * TOWARDS, 12.0)
    assert near_light(SCENE, replace(observation, weights=torch.zeros_like(observation.weights))) is None
    assert near_light(SCENE, replace(observation, samples=torch.zeros_like(observation.samples))) is None
    assert near_light(replace(SCENE, triangles=torch.zeros(0, 3, 3)), observation) is None


def test_a_plane_without_the_shadow_that_it_should_have_tells_nothing() -> None:
    even = torch.full((3, RECEIVER.points), 0.5, dtype=torch.float64)
    assert near_light(SCENE, Observation(even, torch.ones(RECEIVER.points, dtype=torch.float64))) is None
