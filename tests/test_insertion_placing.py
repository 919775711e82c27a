"""Where the new object stands."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.primitives import box
from torchlight.insertion.placing import check_above, stood, unit_scale


@pytest.mark.parametrize(("up", "size"), [("z", (1.0, 2.0, 3.0)), ("y", (1.0, 3.0, 2.0)), ("x", (3.0, 2.0, 1.0))])
def test_it_rests_on_the_plane_at_its_place_whichever_axis_is_up(up: str, size: tuple[float, float, float]) -> None:
    # extents 1, 2, 3 in the mesh's x, y, z; its place in the file does not matter
    placed = stood(box((1.0, 2.0, 3.0)) + 7.0, (5.0, -4.0), 0.0, 2.0, up).reshape(-1, 3)
    low, high = placed.amin(dim=0), placed.amax(dim=0)
    assert_close(high - low, 2 * torch.tensor(size, dtype=torch.float64))
    assert_close((low + high) / 2 * torch.tensor([1.0, 1.0, 0.0]), torch.tensor([5.0, -4.0, 0.0]).double())
    assert_close(low[2], torch.tensor(0.0, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("up", "axis"), [("z", 2), ("y", 1), ("x", 0)])
def test_the_named_axis_points_up_and_nothing_is_mirrored(up: str, axis: int) -> None:
    corner = torch.zeros(1, 3, 3, dtype=torch.float64)
    corner[0, 1, axis] = 1.0
    corner[0, 2, (axis + 1) % 3] = 0.5
    placed = stood(corner, up=up)[0]
    assert_close(placed[1] - placed[0], torch.tensor([0.0, 0.0, 1.0]).double(), rtol=0, atol=1e-12)
    solid = stood(box((1.0, 2.0, 3.0)), up=up)
    volume = (torch.linalg.cross(solid[:, 0], solid[:, 1]) * solid[:, 2]).sum() / 6
    assert_close(volume, torch.tensor(6.0).double())


def test_a_turn_is_counter_clockwise_from_above() -> None:
    arrow = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.1]]], dtype=torch.float64)
    placed = stood(arrow, turn_degrees=90.0)[0]
    assert_close(placed[1] - placed[0], torch.tensor([0.0, 1.0, 0.0]).double(), rtol=0, atol=1e-12)


def test_units() -> None:
    assert unit_scale("cm", "mm") == 10.0
    assert unit_scale("inch", "cm") == pytest.approx(2.54)
    with pytest.raises(ConfigError, match=r"the scene's units: expected one of mm, cm, m, inch, in, got 'unit'"):
        unit_scale("cm", "unit")
    with pytest.raises(ConfigError, match="up: expected x, y or z"):
        stood(box((1.0, 1.0, 1.0)), up="w")


def test_rounding_below_the_plane_is_none() -> None:
    check_above(box((1.0, 1.0, 1.0)) - torch.tensor([0.0, 0.0, 1e-6]).double())
    with pytest.raises(SceneError, match=r"lies 0\.001 below the plane"):
        check_above(box((1.0, 1.0, 1.0)) - torch.tensor([0.0, 0.0, 1e-3]).double())
