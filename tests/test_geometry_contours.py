"""Contour crossings against Embree, a readable twin, the analytic shadow of a block, and laws of any triangle soup."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from realdata import data_path
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import TorchlightWarning
from torchlight.geometry import contour_twin, crossings, primitives
from torchlight.geometry.analytic_shadow import Block, interval_coverage, shadow_intervals
from torchlight.geometry.contours import Contours, prepare, scene_contours
from torchlight.geometry.crossings import Rectangles, on_grid, receiver_grid, visible_integrals
from torchlight.geometry.plane_visibility import hidden_samples
from torchlight.geometry.receiver import Receiver, receiver_corners, receiver_points
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.geometry.visibility import occlusion_test

RECEIVER = Receiver((0.1, -0.2), (4.0, 3.6), (24, 18))
NEAR = 1e-5  # of the scene's size: how near to a shadow's edge two methods may differ


def box(size: tuple[float, float, float], turn: float = 0.0, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Tensor:
    return transform(primitives.box(size), 1.0, (0.0, 0.0, turn), (x, y, z))


def upward(seed: int, count: int, lowest: float = 0.02) -> Tensor:
    """Unit directions, uniform in solid angle above a least z."""
    generator = torch.Generator().manual_seed(seed)
    z = lowest + (1 - lowest) * torch.rand(count, generator=generator, dtype=torch.float64)
    phi = 2 * torch.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * phi.cos(), radius * phi.sin(), z], dim=-1)


def soup(seed: int, faces: int) -> Tensor:
    """An open soup: triangles of all sizes and attitudes that share corners and edges, some double, some cut off."""
    generator = torch.Generator().manual_seed(seed)
    corners = torch.rand(max(4, faces // 2), 3, generator=generator, dtype=torch.float64)
    corners = corners * torch.tensor([2.4, 2.4, 1.8]) - torch.tensor([1.2, 1.2, 0.4])
    loose = torch.randint(len(corners), (faces, 3), generator=generator)
    fan = torch.stack([torch.zeros(3), torch.ones(3), torch.arange(2, 5)], dim=1).long()  # three faces on one edge
    chosen = torch.cat([loose, fan.clamp(max=len(corners) - 1), loose[: faces // 4].flip(1)])
    return corners[chosen]


def unit_mesh(name: str) -> Tensor:
    """A mesh of y up, turned to z up, 1.5 high and standing on the plane."""
    mesh = trimesh.load_mesh(data_path(f"meshes/{name}"), process=False)
    triangles = torch.from_numpy(np.array(mesh.triangles, dtype=np.float64))
    triangles = torch.stack([triangles[..., 0], -triangles[..., 2], triangles[..., 1]], dim=-1)
    low, high = triangles.reshape(-1, 3).amin(dim=0), triangles.reshape(-1, 3).amax(dim=0)
    middle = torch.stack([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return (triangles - middle) * (1.5 / (high - low).max())


def rectangles(seed: int, squares: int, along: int) -> Rectangles:
    """Random rectangles of directions on the planes z = 1 and x = 1, with random weights and lines."""
    generator = torch.Generator().manual_seed(seed)
    a, b, c, d = torch.rand(4, squares, 1, generator=generator, dtype=torch.float64)
    top = torch.arange(squares)[:, None] % 2 == 0
    frame = torch.eye(3, dtype=torch.float64)
    forward = torch.where(top, frame[2], frame[0])
    right, up = frame[1].expand(squares, 3) * (0.02 + 0.2 * a), torch.where(top, -frame[0], frame[2]) * (0.02 + 0.2 * b)
    center = (
        forward
        + torch.where(top, (2 * c - 1) * frame[1], (2 * c - 1) * frame[1])
        + (0.23 + 0.7 * d) * (torch.where(top, -frame[0], frame[2]))
    )
    step = (torch.arange(along, dtype=torch.float64) + 0.5) / along * 2 - 1
    across = step[None, None, :, None] * right[:, None, None]
    along_up = -step[None, :, None, None] * up[:, None, None]
    directions = torch.nn.functional.normalize(center[:, None, None] + across + along_up, dim=-1)
    weights = 0.1 + torch.rand(directions.shape[:3], generator=generator, dtype=torch.float64)
    return Rectangles(center, right, up, directions, weights, torch.rand(weights.shape, generator=generator).double())


def by_twin(contours: Contours, receiver: Receiver, parts: Rectangles, lines: int) -> Tensor:
    grid = receiver_grid(receiver, lines)
    slopes, size = grid.slopes(parts.directions.numpy()), (grid.rows, grid.columns, lines)
    faces = grid.places(contours.faces)
    return torch.from_numpy(
        contour_twin.visible_integrals(faces, slopes, parts.shifts.numpy(), parts.weights.numpy(), size)
    )


def seen_from(triangles: Tensor, directions: Tensor) -> Tensor:
    return hidden_samples(on_grid(scene_contours(Scene(triangles, RECEIVER)), RECEIVER, 1), directions)


# --- against rays --------------------------------------------------------------------------------------------------


def mismatches_off_edges(triangles: Tensor, directions: Tensor, receiver: Receiver) -> tuple[int, float]:
    """Rays whose answer differs from Embree's though no ray within `NEAR` agrees with it; and the hidden share."""
    contours = scene_contours(Scene(triangles, receiver))
    found = hidden_samples(on_grid(contours, receiver, 1), directions)
    points = receiver_points(receiver)
    test = occlusion_test(triangles, receiver_corners(receiver))
    expected = torch.from_numpy(test.hidden_on_plane(points, directions.numpy(), np.zeros((len(directions), 2))))
    number, point = (found != expected).nonzero(as_tuple=True)
    assert len(number) < 1e-3 * found.numel()
    origins, towards = torch.from_numpy(points)[point], directions[number]
    side = torch.nn.functional.normalize(torch.linalg.cross(towards, towards.roll(1, -1) + 0.1), dim=-1)
    other = torch.linalg.cross(towards, side)
    off = torch.ones(len(number), dtype=torch.bool)
    for turn in torch.arange(8) * (torch.pi / 4):
        moved = origins + NEAR / test.frame.scale * (turn.cos() * side + turn.sin() * other)
        off &= torch.from_numpy(test.hidden(moved.numpy(), towards.numpy())) != found[number, point]
    return int(off.sum()), found.double().mean().item()


@pytest.mark.parametrize("name", ["stanford-bunny.obj", "chair_model.obj", "cow.obj"])
def test_meshes_hide_what_embree_says(name: str) -> None:
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (48, 48))
    off, share = mismatches_off_edges(unit_mesh(name), upward(1, 256), receiver)
    assert off == 0
    assert share > 0.02


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), faces=st.integers(1, 60))
def test_any_soup_hides_what_embree_says(seed: int, faces: int) -> None:
    """Open, non-manifold, cut by the plane, with double faces: one object or many."""
    off, _ = mismatches_off_edges(soup(seed, faces), upward(seed, 40), RECEIVER)
    assert off == 0


def test_several_objects_hide_what_one_of_them_hides() -> None:
    one, two = box((1.0, 0.6, 1.2), 20.0), box((0.5, 0.5, 0.5), 30.0, -1.2, 0.7)
    directions = upward(3, 300)
    alone = [seen_from(part, directions) for part in (one, two)]
    both = seen_from(torch.cat([one, two]), directions)
    assert torch.equal(both, alone[0] | alone[1])


def test_directions_below_the_plane_are_hidden() -> None:
    directions = torch.tensor([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]], dtype=torch.float64)
    found = seen_from(torch.zeros(0, 3, 3), directions)
    assert found.all(dim=1).tolist() == [True, True, False]
    assert not found[2].any()


# --- against the twin and the closed form --------------------------------------------------------------------------


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), faces=st.integers(0, 40), lines=st.integers(1, 3), along=st.integers(1, 8))
def test_the_kernel_equals_its_twin(seed: int, faces: int, lines: int, along: int) -> None:
    contours, parts = prepare(soup(seed, faces) if faces else torch.zeros(0, 3, 3), 1e-6), rectangles(seed, 3, along)
    found = visible_integrals(on_grid(contours, RECEIVER, lines), parts)
    assert_close(found, by_twin(contours, RECEIVER, parts, lines), rtol=0, atol=1e-12 * parts.weights.sum().item())
    assert (found >= 0).all()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), faces=st.integers(1, 40))
def test_hidden_samples_equal_their_twin(seed: int, faces: int) -> None:
    contours, directions = prepare(soup(seed, faces), 1e-6), upward(seed, 70)
    grid = receiver_grid(RECEIVER, 1)
    expected = contour_twin.hidden_samples(
        grid.places(contours.faces), grid.slopes(directions.numpy()), grid.rows, grid.columns
    )
    np.testing.assert_array_equal(hidden_samples(on_grid(contours, RECEIVER, 1), directions).numpy(), expected)


def test_a_block_covers_footprints_as_in_closed_form() -> None:
    """On the same lines for the same directions: equal to the rounding of both."""
    block, parts, lines = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2)), rectangles(5, 6, 5), 3
    contours = scene_contours(Scene(box(block.size, 20.0, 0.3, -0.2), RECEIVER))
    found = visible_integrals(on_grid(contours, RECEIVER, lines), parts)
    directions, shifts = parts.directions.reshape(-1, 3), parts.shifts.reshape(-1, 1)
    columns, rows = RECEIVER.samples
    step_x, step_y = RECEIVER.footprint
    left, bottom = (c - s / 2 for c, s in zip(RECEIVER.center, RECEIVER.size, strict=True))
    y = bottom + (torch.arange(rows * lines) + shifts) * step_y / lines
    first, last = shadow_intervals(block, directions, y)
    share = interval_coverage((first - left) / step_x, (last - left) / step_x, columns)
    hidden = share.reshape(6, 25, rows, lines, columns).mean(dim=3).flatten(start_dim=2)
    expected = (parts.weights.reshape(6, 25, 1) * (1 - hidden)).sum(dim=1)
    assert_close(found, expected, rtol=0, atol=1e-11)
    assert 0.02 < hidden.mean().item() < 0.9


def test_a_line_may_have_any_number_of_crossings() -> None:
    """Eighty slats one above the other and side by side: 160 crossings of one line, more than there is room for."""
    slats = [box((0.02, 2.0, 0.01), x=-1.6 + 0.04 * k, z=0.2 + 0.011 * (k % 7)) for k in range(80)]
    contours, parts = prepare(torch.cat(slats), 1e-6), rectangles(9, 2, 2)
    found = visible_integrals(on_grid(contours, RECEIVER, 1), parts)
    assert_close(found, by_twin(contours, RECEIVER, parts, 1), rtol=0, atol=1e-12)


def test_contours_may_coincide() -> None:
    """Boxes that touch: their common edges have four faces and two contours, one exactly on the other."""
    boxes = [box((0.25, 0.3, 0.4 + 0.3 * (k % 2)), x=-1.0 + 0.25 * k, y=0.3 * (k % 2)) for k in range(9)]
    contours, parts = prepare(torch.cat(boxes), 1e-6), rectangles(11, 4, 4)
    found = visible_integrals(on_grid(contours, RECEIVER, 2), parts)
    assert_close(found, by_twin(contours, RECEIVER, parts, 2), rtol=0, atol=1e-12)


def test_directions_may_lie_in_faces_and_lines_may_touch_corners() -> None:
    """Straight down on unturned boxes, with lines through the corners: what float32 cannot decide float64 does."""
    boxes = torch.cat([box((0.6, 0.8, 0.7)), box((0.2, 0.4, 0.3), x=0.9, y=0.6, z=0.4)])
    step = torch.linspace(-0.4, 0.4, 5, dtype=torch.float64)
    directions = torch.stack([step.expand(5, 5), -step[:, None].expand(5, 5), torch.ones(5, 5).double()], dim=-1)
    frame = torch.eye(3, dtype=torch.float64)
    towards, shifts = torch.nn.functional.normalize(directions, dim=-1)[None], torch.zeros(1, 5, 5).double()
    parts = Rectangles(frame[2:], frame[:1] / 2, frame[1:2] / 2, towards, torch.ones(1, 5, 5).double(), shifts)
    contours, receiver = prepare(boxes, 1e-6), Receiver((0.0, 0.0), (4.0, 4.0), (20, 20))
    found = visible_integrals(on_grid(contours, receiver, 1), parts)
    assert_close(found, by_twin(contours, receiver, parts, 1), rtol=0, atol=1e-11)


@pytest.mark.parametrize(("unit", "away"), [(1e-4, 0.0), (1e5, 0.0), (1.0, 3e4)])
def test_float32_leaves_nothing_out(unit: float, away: float) -> None:
    """In any unit, and with something so far away that float32 hardly knows where: many small faces, low light too."""
    generator = torch.Generator().manual_seed(3)
    small = soup(6, 60)[:, :1] + 0.1 * torch.randn(78, 3, 3, generator=generator, dtype=torch.float64)
    there = soup(7, 8) * away + torch.tensor([0.0, away, 0.0])
    contours, parts = prepare(torch.cat([small, there]) * unit, 1e-9 * unit), rectangles(12, 6, 7)
    receiver = Receiver((0.1 * unit, -0.2 * unit), (4.0 * unit, 3.6 * unit), (24, 18))
    found = visible_integrals(on_grid(contours, receiver, 2), parts)
    assert_close(found, by_twin(contours, receiver, parts, 2), rtol=0, atol=1e-10)


def test_without_numba_the_twin_answers_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    contours, parts = prepare(soup(2, 12), 1e-6), rectangles(2, 2, 2)
    shape = on_grid(contours, RECEIVER, 1)
    expected, directions = visible_integrals(shape, parts), upward(2, 5)
    marks = hidden_samples(on_grid(contours, RECEIVER, 1), directions)

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(crossings, "import_module", missing)
    with pytest.warns(TorchlightWarning, match="numba is not installed"):
        assert_close(visible_integrals(shape, parts), expected, rtol=0, atol=1e-12)
    with pytest.warns(TorchlightWarning, match="numba is not installed"):
        assert torch.equal(hidden_samples(on_grid(contours, RECEIVER, 1), directions), marks)


# --- preparation ---------------------------------------------------------------------------------------------------


def test_a_cube_has_its_twelve_edges_but_those_on_the_plane_are_open() -> None:
    """The face on the plane is dropped, and so are the flat diagonals of the others."""
    standing, hovering = (prepare(box((1.0, 1.0, 1.0), z=z), 1e-6) for z in (0.0, 0.5))
    assert (len(hovering.ends), int((hovering.sides[:, 1] == 0).sum())) == (12, 0)
    assert (len(standing.ends), int((standing.sides[:, 1] == 0).sum())) == (12, 4)
    assert len(standing.faces) == 10


def test_below_the_plane_there_is_nothing() -> None:
    assert len(prepare(box((1.0, 1.0, 1.0), z=-1.0), 1e-6).ends) == 0


def test_a_cut_edge_gets_one_new_corner() -> None:
    """A tilted cube half below the plane: its section is closed to the bit, and nothing reaches below."""
    tilted = transform(primitives.box((1.0, 1.0, 1.0)), 1.0, (31.0, 17.0, 5.0), (0.0, 0.0, -0.4))
    contours = prepare(tilted, 1e-6)
    assert contours.faces[..., 2].min() == 0.0
    cut = contours.sides[:, 1] == 0
    assert (contours.ends[cut][..., 2] == 0).all()
    corners, visits = np.unique(contours.ends[cut].reshape(-1, 3), axis=0, return_counts=True)
    assert len(corners) >= 3
    assert (visits == 2).all()


def test_faces_about_an_edge_are_paired_in_turn() -> None:
    """Six half planes about the z axis, given in any order: neighbours in angle of their lines belong together."""
    angle = torch.tensor([10.0, 130.0, 40.0, 100.0, 70.0, 160.0]).double().deg2rad()
    rim = torch.stack([angle.cos(), angle.sin(), 0.5 + 0 * angle], dim=-1)
    feet, tops = torch.tensor([0.0, 0.0, 0.2]).double(), torch.tensor([0.0, 0.0, 0.9]).double()
    faces = torch.stack([feet.expand(6, 3), tops.expand(6, 3), rim], dim=1)
    contours = prepare(faces, 1e-9)
    upright = (contours.ends[..., :2] == 0).all(axis=(1, 2))
    assert upright.sum() == 3
    cosine = abs((contours.normals[upright, 0] * contours.normals[upright, 1]).sum(axis=1))
    np.testing.assert_allclose(cosine, np.cos(np.radians(30.0)), atol=1e-12)


def test_double_faces_count_once() -> None:
    once, twice = (prepare(part, 1e-6) for part in (soup(4, 20), torch.cat([soup(4, 20), soup(4, 20).roll(1, 1)])))
    np.testing.assert_array_equal(once.ends, twice.ends)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_clusters_hold_their_normals(seed: int) -> None:
    """Every normal of a cluster lies within its spread of its axis, up to one sign for both faces of an edge."""
    contours = prepare(torch.cat([soup(seed, 30), primitives.sphere(0.5, 24)]), 1e-6)
    cluster = np.repeat(np.arange(len(contours.axes)), np.diff(contours.first))
    towards = contours.normals * contours.sides[..., None] * [[1.0], [-1.0]]
    cosine = np.einsum("efi,ei->ef", towards, contours.axes[cluster])
    narrow = contours.spread[cluster] < np.pi
    assert (contours.sides[narrow] != 0).all()
    least = np.cos(contours.spread[cluster][narrow]) - 1e-9
    assert ((cosine[narrow] >= least[:, None]).all(axis=1) | (-cosine[narrow] >= least[:, None]).all(axis=1)).all()
    assert narrow.mean() > 0.3


def test_importing_the_package_does_not_import_numba() -> None:
    """It takes a third of a second; the kernel asks for it when it is first used."""
    code = "import sys, torchlight.transfer; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
