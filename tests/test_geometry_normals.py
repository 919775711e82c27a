"""Normals for shading: smooth where a surface is, creased where it is not."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.geometry import normals
from torchlight.geometry.primitives import box, cylinder, sphere


def test_a_sphere_s_corners_look_away_from_its_middle() -> None:
    triangles = sphere(0.5, 48)
    radial = torch.nn.functional.normalize(triangles - torch.tensor([0.0, 0.0, 0.5]).double(), dim=-1)
    assert_close(normals.corner_normals(triangles), radial, rtol=0, atol=0.01)


def test_a_box_keeps_its_edges() -> None:
    triangles = box((1.0, 2.0, 3.0))
    flat = normals.face_normals(triangles)
    assert_close(normals.corner_normals(triangles), flat[:, None].expand(-1, 3, -1), rtol=0, atol=1e-12)
    smooth = normals.corner_normals(triangles, 180.0)
    corner = torch.nn.functional.normalize(triangles - torch.tensor([0.0, 0.0, 1.5]).double(), dim=-1).sign()
    assert_close(
        smooth, corner / 3**0.5, rtol=0, atol=1e-12
    )  # three right angles weigh alike, however cut in triangles


def test_a_cylinder_is_smooth_around_and_creased_at_its_lid() -> None:
    triangles = cylinder(1.0, 2.0, 32)
    smooth, flat = normals.corner_normals(triangles), normals.face_normals(triangles)
    side = flat[:, 2].abs() < 0.5
    around = torch.nn.functional.normalize(triangles[side] * torch.tensor([1.0, 1.0, 0.0]).double(), dim=-1)
    assert_close(smooth[side], around, rtol=0, atol=0.01)
    assert_close(smooth[~side], flat[~side][:, None].expand(-1, 3, -1), rtol=0, atol=1e-12)


def test_many_corners_are_done_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    triangles = sphere(0.5, 12)
    whole = normals.corner_normals(triangles)
    monkeypatch.setattr(normals, "PAIRS_AT_ONCE", 50)
    assert_close(normals.corner_normals(triangles), whole, rtol=0, atol=0)


def test_a_face_without_area_has_no_normal() -> None:
    assert normals.face_normals(torch.zeros(1, 3, 3, dtype=torch.float64)).tolist() == [[0.0, 0.0, 0.0]]
