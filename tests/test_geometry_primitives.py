from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import SceneError
from torchlight.geometry.primitives import box, cone, cylinder, sphere

SOLIDS = {
    "box": box((2.0, 3.0, 4.0)),
    "cylinder": cylinder(1.5, 4.0, 64),
    "cone": cone(1.5, 4.0, 64),
    "sphere": sphere(1.5, 64),
}


def volume(triangles: Tensor) -> float:
    """Sum of signed tetrahedra: positive only if faces point outwards."""
    return (torch.linalg.det(triangles) / 6).sum().item()


def area(triangles: Tensor) -> float:
    edges = triangles[:, 1:] - triangles[:, :1]
    return torch.linalg.vector_norm(torch.linalg.cross(edges[:, 0], edges[:, 1]), dim=-1).sum().item() / 2


def polygon_area(radius: float, segments: int) -> float:
    return segments / 2 * radius**2 * math.sin(2 * math.pi / segments)


@pytest.mark.parametrize("name", SOLIDS)
def test_closed_oriented_and_without_slivers(name: str) -> None:
    edges: Counter[tuple[tuple[float, ...], ...]] = Counter()
    for triangle in SOLIDS[name].round(decimals=9).add(0.0).tolist():
        corners = [tuple(corner) for corner in triangle]
        assert len(set(corners)) == 3
        edges.update(zip(corners, corners[1:] + corners[:1], strict=True))
    assert set(edges.values()) == {1}
    assert all((end, start) in edges for start, end in edges)


@pytest.mark.parametrize("name", SOLIDS)
def test_rests_on_the_plane_and_is_centred(name: str) -> None:
    corners = SOLIDS[name].reshape(-1, 3)
    low, high = corners.amin(dim=0), corners.amax(dim=0)
    assert_close(low[2].item(), 0.0, rtol=0, atol=1e-12)
    assert_close(low[:2], -high[:2], rtol=0, atol=1e-12)
    extent = {"box": [2, 3, 4], "cylinder": [3, 3, 4], "cone": [3, 3, 4], "sphere": [3, 3, 3]}[name]
    assert_close(high - low, torch.tensor(extent, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SOLIDS)
def test_faces_point_outwards(name: str) -> None:
    triangles = SOLIDS[name]
    center = triangles.reshape(-1, 3).mean(dim=0)
    edges = triangles[:, 1:] - triangles[:, :1]
    normals = torch.linalg.cross(edges[:, 0], edges[:, 1])
    assert bool((((triangles.mean(dim=1) - center) * normals).sum(dim=-1) > 0).all())


def test_volumes_and_areas() -> None:
    assert_close(volume(SOLIDS["box"]), 24.0, rtol=1e-12, atol=0)
    assert_close(area(SOLIDS["box"]), 52.0, rtol=1e-12, atol=0)
    base = polygon_area(1.5, 64)
    side = 2 * 1.5 * math.sin(math.pi / 64)
    apothem = 1.5 * math.cos(math.pi / 64)
    assert_close(volume(SOLIDS["cylinder"]), 4 * base, rtol=1e-12, atol=0)
    assert_close(area(SOLIDS["cylinder"]), 2 * base + 64 * side * 4, rtol=1e-12, atol=0)
    assert_close(volume(SOLIDS["cone"]), 4 * base / 3, rtol=1e-12, atol=0)
    assert_close(area(SOLIDS["cone"]), base + 64 * side * math.hypot(4, apothem) / 2, rtol=1e-12, atol=0)
    rings = [(1.5 * math.cos(a), 1.5 * math.sin(a)) for a in (-math.pi / 2 + math.pi * k / 32 for k in range(33))]
    # a band between similar polygons is a prismatoid: height / 3 (A + sqrt(A B) + B)
    frusta = sum(
        (z2 - z1) / 3 * polygon_area(1, 64) * (r1**2 + r1 * r2 + r2**2) for (r1, z1), (r2, z2) in pairwise(rings)
    )
    assert_close(volume(SOLIDS["sphere"]), frusta, rtol=1e-12, atol=0)


def test_what_inscribing_loses_at_the_default_resolution() -> None:
    loss = {
        "cylinder": 1 - volume(cylinder(1.0, 1.0)) / math.pi,
        "cone": 1 - volume(cone(1.0, 1.0)) / (math.pi / 3),
        "sphere": 1 - volume(sphere(1.0)) / (4 * math.pi / 3),
        "rim": 1 - math.cos(math.pi / 128),
    }
    expected = {"cylinder": 4.0e-4, "cone": 4.0e-4, "sphere": 1.0e-3, "rim": 3.0e-4}
    for name, value in expected.items():
        assert_close(loss[name], value, rtol=0.05, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype(dtype: torch.dtype) -> None:
    made = [
        box((1.0, 1.0, 1.0), dtype=dtype),
        cylinder(1.0, 1.0, dtype=dtype),
        cone(1.0, 1.0, dtype=dtype),
        sphere(1.0, dtype=dtype),
    ]
    assert {triangles.dtype for triangles in made} == {dtype}


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_lengths_must_be_positive(bad: float) -> None:
    for name, make in {
        "box": lambda: box((1.0, bad, 1.0)),
        "cylinder": lambda: cylinder(bad, 1.0),
        "cone": lambda: cone(1.0, bad),
        "sphere": lambda: sphere(bad),
    }.items():
        with pytest.raises(SceneError, match=f"{name}: expected positive, finite lengths"):
            make()


@pytest.mark.parametrize("segments", [2, 5])
def test_segments_must_be_even(segments: int) -> None:
    with pytest.raises(SceneError, match=f"even number of at least 4, got {segments}"):
        sphere(1.0, segments)
