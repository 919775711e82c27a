"""The transport as tensor operations: to the bit what the compiled kernel makes of the same directions."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.devices import moved
from torchlight.geometry import contour_device, contour_twin, crossings, primitives
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.contours import prepare
from torchlight.geometry.receiver import Receiver
from torchlight.light import cubemap
from torchlight.synthetic import block_scene
from torchlight.transfer import directions_of, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (16, 16))
SCENE = block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER)


def soup(seed: int, faces: int) -> Tensor:
    """Returns triangles that hang in the air, cut each other and reach below the plane."""
    random = partial(torch.rand, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    middle = random(faces, 1, 3) * torch.tensor([3.0, 3.0, 1.5]) - torch.tensor([1.5, 1.5, 0.3])
    return middle + (random(faces, 3, 3) - 0.5)


SHAPES = {
    "a block": SCENE.triangles,
    "a sphere": primitives.sphere(0.8)[::8],
    "a soup": soup(0, 40),
    "a flat triangle on the plane": torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=torch.float64),
    "nothing": torch.zeros(0, 3, 3, dtype=torch.float64),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_transport_is_the_compiled_kernels(shape, device):
    receiver = Receiver((0.1, -0.2), (4.0, 3.0), (12, 9))
    on_grid = crossings.on_grid(prepare(SHAPES[shape], 1e-9), receiver, 2)
    rectangles = directions_of(cubemap.whole_texels(4), 3)
    right = crossings.visible_integrals(on_grid, rectangles)
    found = contour_device.visible_integrals(contour_device.on_device(on_grid, device), moved(rectangles, device))
    assert found.device.type == device.type
    # the kernel sorts crossings without the last three bits of their places
    assert_close(found.cpu(), right, rtol=0, atol=2e-15)


def test_transport_is_the_readable_twins():
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (8, 8))
    shape, rectangles = (
        crossings.on_grid(prepare(soup(1, 12), 1e-9), receiver, 2),
        directions_of(cubemap.whole_texels(2), 2),
    )
    grid = shape.grid
    slopes = grid.slopes(rectangles.directions.numpy())
    faces, size = grid.places(shape.contours.faces), (grid.rows, grid.columns, grid.lines)
    parts = (rectangles.shifts.numpy(), rectangles.weights.numpy())
    right = torch.from_numpy(contour_twin.visible_integrals(faces, slopes, *parts, size))
    found = contour_device.visible_integrals(contour_device.on_device(shape, "cpu"), rectangles)
    assert_close(found, right, rtol=0, atol=1e-13)


def test_transport_in_small_pieces_is_the_same(monkeypatch):
    shape = crossings.on_grid(prepare(SHAPES["a soup"], 1e-9), RECEIVER, 2)
    edges, rectangles = contour_device.on_device(shape, "cpu"), directions_of(cubemap.whole_texels(4), 2)
    whole = contour_device.visible_integrals(edges, rectangles)
    monkeypatch.setattr(contour_device, "PAIRS_AT_ONCE", 200)
    monkeypatch.setattr(contour_device, "DIRECTIONS_AT_ONCE", 100)
    assert torch.equal(contour_device.visible_integrals(edges, rectangles), whole)


def test_transport_of_a_scene_is_made_where_it_is_asked_for(device, monkeypatch):
    monkeypatch.setattr("torchlight.transfer.VALUES_ON_DEVICE", 20 * RECEIVER.points)
    seen: list[tuple[int, int]] = []
    made = transport(SCENE, 4, 4, lambda done, all_of_them: seen.append((done, all_of_them)), device)
    assert made.transport.device.type == device.type
    assert torch.equal(made.transport.cpu(), transport(SCENE, 4, 4).transport)
    assert seen[-1] == (48, 48)
