"""Occluders, dome, camera and turns of the viewer; no viser is needed."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.camera import Camera
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.viewer.meshes import about_z, dome_mesh, dome_radius, frustum, occluder_mesh, quaternion


def rotation(wxyz: tuple[float, float, float, float]) -> torch.Tensor:
    """Returns the matrix of a quaternion, column by column as q e q*."""
    w, x, y, z = wxyz
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64)


def test_a_box_has_eight_corners() -> None:
    triangles = box((1.0, 2.0, 3.0))
    mesh = occluder_mesh(triangles)
    assert (mesh.vertices.shape, mesh.faces.shape) == ((8, 3), (12, 3))
    assert_close(torch.from_numpy(mesh.vertices[mesh.faces]), triangles.float())
    assert len(occluder_mesh(torch.zeros(0, 3, 3)).faces) == 0


def test_the_dome_shows_its_inside_and_has_the_map_where_it_belongs() -> None:
    dome = dome_mesh(2.0, rows=6, columns=24)
    corners = dome.vertices[dome.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.linalg.norm(normals, axis=1) > 1e-6  # triangles at the zenith have no area
    inwards = -(normals * corners.mean(axis=1)).sum(axis=1)
    assert (inwards[solid] > 0).all()
    assert np.linalg.norm(dome.vertices, axis=1) == pytest.approx(2.0, rel=1e-6)
    assert dome.vertices[:, 2].min() == pytest.approx(0, abs=1e-6)
    for vertex, (across, up) in zip(dome.vertices, dome.places, strict=True):
        theta = math.acos(min(1.0, vertex[2] / 2))
        assert 1 - up == pytest.approx(theta / (math.pi / 2), abs=1e-3)  # acos near the zenith, in float32
        if math.hypot(vertex[0], vertex[1]) > 1e-3 and 0 < across < 1:
            assert across == pytest.approx(0.5 - math.atan2(vertex[1], vertex[0]) / (2 * math.pi), abs=1e-6)


def test_the_dome_holds_everything() -> None:
    low = Scene(box((1.0, 1.0, 1.0)), Receiver((5.0, 0.0), (6.0, 8.0), (4, 4)))
    assert dome_radius(low) == pytest.approx(1.25 * math.hypot(5.5, 0.5, 1.0))
    empty = Scene(torch.zeros(0, 3, 3), Receiver((5.0, 0.0), (6.0, 8.0), (4, 4)))
    assert dome_radius(empty) == pytest.approx(1.25 * 5)


def test_quaternions_give_their_rotation_back() -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        q, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
        turn = q * torch.linalg.det(q)
        assert_close(rotation(quaternion(turn)), turn)
    for half_turn in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]):
        turn = torch.diag(torch.tensor(half_turn, dtype=torch.float64))
        assert_close(rotation(quaternion(turn)), turn)


def test_a_turn_about_z_is_counter_clockwise_from_above() -> None:
    assert_close(
        rotation(about_z(90.0)) @ torch.tensor([1.0, 0, 0], dtype=torch.float64), torch.tensor([0.0, 1, 0]).double()
    )


def test_a_camera_that_looks_down() -> None:
    """x right = world x, y down = world -y, z forward = world -z, 7 above the plane."""
    pose = torch.tensor([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 7], [0, 0, 0, 1]])
    intrinsics = torch.tensor([[50.0, 0, 49.5], [0, 50, 49.5], [0, 0, 1]])
    cone = frustum(Camera(intrinsics, pose, (200, 100), torch.zeros(5)))
    assert (cone.fov_radians, cone.aspect) == pytest.approx((math.pi / 2, 2))
    assert cone.position == pytest.approx((0, 0, 7))
    forward = rotation(cone.wxyz) @ torch.tensor([0.0, 0, 1], dtype=torch.float64)
    assert_close(forward, torch.tensor([0.0, 0, -1], dtype=torch.float64))
