"""Where the drawn and the stored observability map put each direction."""

from __future__ import annotations

import math

import torch
from torch.testing import assert_close

from torchlight.analysis.observability import Observability
from torchlight.light import cubemap, latlong
from torchlight.report.hemisphere import at_directions, disc_directions, latlong_map

COUNT = cubemap.texel_count(8)


def test_a_value_is_found_in_its_texel_s_direction_and_nowhere_below() -> None:
    values = torch.arange(1.0, COUNT + 1, dtype=torch.float64)
    directions = cubemap.texel_directions(8, 5)[cubemap.visible_texels(8)]
    assert torch.equal(at_directions(values, 8, directions), values)
    below = directions * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    assert torch.equal(at_directions(values, 8, below), torch.zeros_like(values))


def test_the_disc_keeps_areas_and_has_y_up() -> None:
    directions, inside = disc_directions(400)
    share = (inside & (directions[..., 2] > 0.5)).sum() / inside.sum()
    assert_close(share.item(), 0.5, rtol=0, atol=2e-3)  # half of the hemisphere lies above 30 degrees
    assert_close(inside.double().mean().item(), math.pi / 4, rtol=0, atol=2e-3)
    assert directions[10, 200, 1] > 0.9
    assert directions[200, 390, 0] > 0.9
    assert_close(directions[inside].norm(dim=1).min().item(), 1.0, rtol=1e-12, atol=0)


def test_the_stored_map_is_a_lat_long_in_torchlight_s_layout() -> None:
    directions = cubemap.texel_directions(8, 5)[cubemap.visible_texels(8)]
    diagonal = (directions @ torch.tensor([0.0, 0.8, 0.6], dtype=torch.float64)).clamp(min=0)
    reached = directions[:, 2] > 0.2
    seen = Observability(diagonal, (1 - diagonal).sqrt(), reached, torch.ones(1, dtype=torch.float64), 8)
    found = latlong_map(seen)
    assert found.shape == (3, 256, 512)
    brightest = found[0].argmax()
    towards = latlong.pixel_directions(256).reshape(-1, 3)[brightest]
    assert towards @ torch.tensor([0.0, 0.8, 0.6], dtype=torch.float64) > 0.97
    upper = found[:, :128]
    assert_close(upper[1], (1 - upper[0]).sqrt(), rtol=0, atol=1e-12)
    assert set(found[2].unique().tolist()) == {0.0, 1.0}
    assert torch.equal(found[:, 128:], torch.zeros(3, 128, 512, dtype=torch.float64))
