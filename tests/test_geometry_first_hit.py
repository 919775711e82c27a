"""What a ray sees first: closed forms, and Embree against its torch twin."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import TorchlightWarning
from torchlight.geometry import embree as embree_module
from torchlight.geometry import first_hit, visibility
from torchlight.geometry.primitives import box, sphere

BOUNDS = torch.tensor([[-3.0, -3.0, 0.0], [3.0, 3.0, 0.0]], dtype=torch.float64)


def rays(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Rays from a ball of radius 4 towards points near the origin."""
    generator = torch.Generator().manual_seed(seed)
    draw = torch.randn(2, count, 3, generator=generator, dtype=torch.float64)
    origins = 4 * torch.nn.functional.normalize(draw[0], dim=-1)
    return origins, torch.nn.functional.normalize(0.6 * draw[1] - origins, dim=-1)


def test_a_ray_down_on_a_box_ends_on_its_lid() -> None:
    eye = first_hit.first_hit(box((1.0, 1.0, 0.5)), BOUNDS)
    down = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
    hits = eye.seen(torch.tensor([[0.3, -0.2, 2.0]], dtype=torch.float64), down)
    assert_close(hits.distance, torch.tensor([1.5], dtype=torch.float64), rtol=1e-6, atol=0)
    face = box((1.0, 1.0, 0.5))[hits.face[0]]
    place = (hits.corners[0][:, None] * face).sum(dim=0)
    assert_close(place, torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64), rtol=0, atol=1e-6)


def test_what_is_missed_is_infinitely_far() -> None:
    eye = first_hit.first_hit(box((1.0, 1.0, 0.5)), BOUNDS)
    hits = eye.seen(
        torch.tensor([[2.0, 0.0, 2.0]], dtype=torch.float64), torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
    )
    assert hits.distance.isinf().all()
    assert hits.face.tolist() == [-1]
    assert hits.corners.tolist() == [[0.0, 0.0, 0.0]]


def test_nothing_is_seen_of_no_triangles() -> None:
    origins, directions = rays(4)
    hits = first_hit.first_hit(torch.zeros(0, 3, 3, dtype=torch.float64), BOUNDS).seen(origins, directions)
    assert hits.distance.isinf().all()


def test_embree_sees_what_its_twin_sees() -> None:
    triangles = torch.cat([sphere(0.7, 16), box((1.0, 0.6, 1.2)) + torch.tensor([0.9, 0.2, 0.0]).double()])
    frame = visibility.unit_frame(torch.cat([triangles.reshape(-1, 3), BOUNDS]))
    origins, directions = rays(400)
    embree = first_hit.FirstHit(frame, first_hit.nearest_by_embree(triangles, frame)).seen(origins, directions)
    twin = first_hit.FirstHit(frame, first_hit.nearest_by_torch(triangles, frame)).seen(origins, directions)
    assert 0 < int((twin.face >= 0).sum()) < 400
    assert torch.equal(embree.face >= 0, twin.face >= 0)
    there = twin.face >= 0
    assert_close(embree.distance[there], twin.distance[there], rtol=2e-6, atol=0)  # float32
    same = there & (embree.face == twin.face)  # on an edge either face is right
    assert int(same.sum()) > 0.95 * int(there.sum())
    assert_close(embree.corners[same], twin.corners[same], rtol=0, atol=2e-4)


def test_without_embree_the_twin_answers_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embree_module, "backend", lambda: "raycast")
    with pytest.warns(TorchlightWarning, match="slow torch ray caster"):
        eye = first_hit.first_hit(box((1.0, 1.0, 0.5)), BOUNDS)
    down = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
    found = eye.seen(torch.tensor([[0.3, -0.2, 2.0]], dtype=torch.float64), down).distance
    assert_close(found, torch.tensor([1.5], dtype=torch.float64), rtol=1e-6, atol=0)
