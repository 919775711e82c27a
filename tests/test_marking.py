"""light.png with its marks: hatched where little is determined, crossed below the plane, and nothing else changed."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import torch
from PIL import Image

from torchlight.analysis.confidence import Confidence
from torchlight.marking import GROUND, GROUND_LINE, LEGEND_ROWS, marked_light
from torchlight.preview import to_srgb8

HEIGHT = 64
HALF = torch.tensor([1.0] * 24 + [0.0] * 24)


def confidence(observability: torch.Tensor, seen: torch.Tensor | None = None) -> Confidence:
    seen = torch.ones(48, dtype=torch.bool) if seen is None else seen
    return Confidence(observability, 4, torch.ones(3, 48), seen, 4, 0.01)


def picture(light: torch.Tensor, told: Confidence, fill: str = "none") -> np.ndarray:
    return np.asarray(Image.open(BytesIO(marked_light(to_srgb8(light), told, fill))))


def test_what_is_determined_is_shown_as_it_is() -> None:
    light = torch.full((3, HEIGHT, 2 * HEIGHT), 0.25)
    shown = picture(light, confidence(torch.ones(48)))
    assert shown.shape == (HEIGHT + 2 * LEGEND_ROWS, 2 * HEIGHT, 3)
    assert set(shown[: HEIGHT // 2].flatten().tolist()) == {137}
    assert {tuple(colour) for colour in shown[HEIGHT // 2 : HEIGHT].reshape(-1, 3).tolist()} == {GROUND, GROUND_LINE}


def test_lines_lie_over_what_is_not_determined_only() -> None:
    light = torch.full((3, HEIGHT, 2 * HEIGHT), 0.25)
    told = confidence(HALF)
    shown = picture(light, told)[: HEIGHT // 2, :, 0]
    changed, doubtful = shown != 137, told.observability_map(HEIGHT)[: HEIGHT // 2].numpy() < 0.5
    assert not changed[~doubtful].any()
    assert 0.1 < changed[doubtful].mean() < 0.3
    white, black = (picture(light * value, told)[: HEIGHT // 2, :, 0] for value in (1e3, 0.0))
    assert len(np.unique(white)) == len(np.unique(black)) == 2  # the lines are seen on both


def test_a_filled_floor_is_shown_and_crossed() -> None:
    light = torch.full((3, HEIGHT, 2 * HEIGHT), 0.25)
    floor = picture(light, confidence(torch.ones(48)), "smooth")[HEIGHT // 2 : HEIGHT]
    assert {tuple(colour) for colour in floor.reshape(-1, 3).tolist()} == {(137, 137, 137), GROUND_LINE}


def test_directions_that_no_sample_sees_are_crossed_above_the_plane_too() -> None:
    seen = torch.ones(48, dtype=torch.bool)
    seen[32:] = False  # the top face
    shown = picture(torch.full((3, HEIGHT, 2 * HEIGHT), 0.25), confidence(torch.ones(48), seen))
    assert {tuple(colour) for colour in shown[:4].reshape(-1, 3).tolist()} == {GROUND, GROUND_LINE}
