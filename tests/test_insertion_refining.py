"""From coarse to fine: what is smooth is interpolated, what is sharp is computed."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.geometry.receiver import Receiver
from torchlight.insertion import refining
from torchlight.insertion.refining import Steps, refined
from torchlight.insertion.sight import Sight

RECEIVER = Receiver((0.0, 0.0), (4.0, 3.0), (8, 6))


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refining, "COARSEST", 200)


def centres(view: Sight, index: Tensor) -> Tensor:
    """x and y of cells, as shares of the picture."""
    columns = view.grid[0]
    place = (torch.stack([index % columns, index // columns], dim=-1).double() + 0.5) * view.step
    return place / torch.tensor(view.size).double()


def test_a_smooth_picture_is_computed_coarsely_and_right() -> None:
    sight = Sight(None, RECEIVER, (101, 75), 9.0)
    asked = []

    def ramp(view: Sight, index: Tensor) -> tuple[Tensor, Tensor]:
        asked.append(len(index))
        x, y = centres(view, index).unbind(dim=1)
        return torch.stack([0.3 * x + 0.2 * y, x], dim=1), torch.ones(len(index), dtype=torch.long)

    picture = refined(sight, ramp, 1, Steps(None, 1))
    assert picture.values.shape == (2, 75, 101)
    assert sum(asked) < 0.4 * 101 * 75
    expected = ramp(sight, torch.arange(sight.cells))[0].T.reshape(2, 75, 101)
    assert_close(picture.values[:, 8:-8, 8:-8], expected[:, 8:-8, 8:-8], rtol=0, atol=1e-9)
    assert_close(picture.values, expected, rtol=0, atol=0.05)  # constant beyond the outermost centres of coarse cells


def test_edges_are_computed_pixel_by_pixel() -> None:
    sight = Sight(None, RECEIVER, (96, 72), 9.0)

    def disk(view: Sight, index: Tensor) -> tuple[Tensor, Tensor]:
        x, y = ((centres(view, index) - 0.5) * torch.tensor([4.0, 3.0])).unbind(dim=1)
        return ((x.square() + y.square()) < 1).double()[:, None], (x > 1.4).long()

    picture = refined(sight, disk, 1, Steps(None, 1))
    values, kind = disk(sight, torch.arange(sight.cells))
    assert torch.equal(picture.values.flatten(), values.flatten())
    assert torch.equal(picture.kind.flatten(), kind)


def test_a_budget_stops_it_and_the_rest_is_interpolated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refining, "MOST", 300)
    steps = []
    sight = Sight(None, RECEIVER, (96, 72), 9.0)

    def noise(view: Sight, index: Tensor) -> tuple[Tensor, Tensor]:
        return torch.rand(len(index), 1).double(), torch.ones(len(index), dtype=torch.long)

    picture = refined(sight, noise, 1, Steps(lambda done, total: steps.append((done, total)), 10))
    assert picture.values.shape == (1, 72, 96)
    assert picture.values.isfinite().all()
    assert steps[-1][0] <= 300
    assert all(done <= total for done, total in steps)
