"""The cube map: frames, edges, exact solid angles and cosines, the plane's unknowns."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from scipy.integrate import dblquad
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.light import cubemap

RESOLUTIONS = [1, 2, 3, 8, 16]
PX, NX, PY, NY, PZ, NZ = range(6)


def random_directions(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)


def integral(f: Callable[[float, float], float], left: float, right: float, bottom: float, top: float) -> float:
    """Integral of f(v, u) over a rectangle, by scipy."""
    return dblquad(f, left, right, bottom, top, epsabs=1e-14)[0]


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


# --- frames and coordinates ----------------------------------------------------------------------------------------


def test_frames_are_orthonormal_and_all_of_one_hand() -> None:
    frames = cubemap.face_frames()
    assert_close(frames @ frames.transpose(-1, -2), torch.eye(3, dtype=torch.float64).expand(6, 3, 3))
    assert_close(torch.linalg.det(frames), -torch.ones(6, dtype=torch.float64))


def test_forward_vectors_follow_the_face_order() -> None:
    expected = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    assert_close(cubemap.face_frames()[:, 2], torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize(
    ("face", "u", "v", "expected"),
    [
        (PX, 1.0, 0.0, (1.0, -1.0, 0.0)),
        (PX, 0.0, 1.0, (1.0, 0.0, 1.0)),
        (NX, 1.0, 0.5, (-1.0, 1.0, 0.5)),
        (PY, 1.0, 0.5, (1.0, 1.0, 0.5)),
        (NY, 1.0, 0.5, (-1.0, -1.0, 0.5)),
        (PZ, 1.0, 0.5, (-0.5, -1.0, 1.0)),
        (NZ, 1.0, 0.5, (0.5, -1.0, -1.0)),
    ],
)
def test_face_points_have_literal_directions(face: int, u: float, v: float, expected: tuple[float, ...]) -> None:
    actual = cubemap.face_directions(torch.tensor([face]), vector(u), vector(v))[0]
    assert_close(actual, torch.nn.functional.normalize(vector(*expected), dim=0))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((PX, "top"), (PZ, "bottom")),
        ((NX, "top"), (PZ, "top reversed")),
        ((PY, "top"), (PZ, "left reversed")),
        ((NY, "top"), (PZ, "right")),
        ((PX, "bottom"), (NZ, "top")),
        ((PX, "right"), (NY, "left")),
        ((PX, "left"), (PY, "right")),
        ((NX, "left"), (NY, "right")),
        ((NX, "right"), (PY, "left")),
    ],
)
def test_neighbouring_faces_share_their_edge(first: tuple[int, str], second: tuple[int, str]) -> None:
    assert_close(edge(*first), edge(*second))


def edge(face: int, side: str) -> torch.Tensor:
    """Directions along one side of a face: from left to right, or from bottom to top."""
    along = torch.linspace(-1, 1, 5, dtype=torch.float64)
    along = along.flip(0) if side.endswith("reversed") else along
    ones = torch.ones_like(along)
    u, v = {"top": (along, ones), "bottom": (along, -ones), "left": (-ones, along), "right": (ones, along)}[
        side.split(maxsplit=1)[0]
    ]
    return cubemap.face_directions(torch.full((5,), face), u, v)


def test_locate_inverts_face_directions() -> None:
    directions = random_directions(500)
    face, u, v = cubemap.locate(5.0 * directions)
    assert set(face.tolist()) == set(range(6))
    assert torch.stack([u, v]).abs().max().item() <= 1.0
    assert_close(cubemap.face_directions(face, u, v), directions)


def test_texel_centres_follow_the_index_formula() -> None:
    resolution = 4
    directions = cubemap.texel_directions(resolution)
    face, row, column = PY, 1, 3
    u, v = 2 * (column + 0.5) / resolution - 1, 1 - 2 * (row + 0.5) / resolution
    expected = torch.nn.functional.normalize(vector(u, 1.0, v), dim=0)  # forward +y, right +x, up +z
    assert_close(directions[(face * resolution + row) * resolution + column], expected)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("faces", [5, 6])
def test_texel_index_finds_every_texel_from_its_centre(resolution: int, faces: int) -> None:
    directions = cubemap.texel_directions(resolution, faces)
    assert_close(cubemap.texel_index(directions, resolution), torch.arange(faces * resolution**2))


def test_texel_index_stays_inside_at_corners() -> None:
    corners = torch.cartesian_prod(*[vector(-1, 1)] * 3)
    index = cubemap.texel_index(corners, 4)
    assert index.min().item() >= 0
    assert index.max().item() < 6 * 16
    cosine = (cubemap.texel_directions(4)[index] * corners).sum(dim=-1) / math.sqrt(3)
    assert_close(cosine, torch.full_like(cosine, (2 * 0.75 + 1) / math.sqrt(3 * (2 * 0.75**2 + 1))))


# --- solid angles --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resolution", [1, 2, 3, 16, 128])
def test_solid_angles_of_six_and_five_faces(resolution: int) -> None:
    face = cubemap.solid_angles(resolution)
    assert_close(6 * face.sum().item(), 4 * math.pi, rtol=1e-12, atol=0)
    assert_close(5 * face.sum().item(), 4 * math.pi * 5 / 6, rtol=1e-12, atol=0)


def test_solid_angle_falls_by_three_to_the_three_halves_from_centre_to_corner() -> None:
    face = cubemap.solid_angles(512)
    assert_close((face[256, 256] / face[0, 0]).item(), 3**1.5, rtol=1e-2, atol=0)


def test_solid_angle_of_a_texel_against_quadrature() -> None:
    resolution, row, column = 8, 1, 6
    u, v = 2 * column / resolution - 1, 1 - 2 * (row + 1) / resolution
    expected = integral(lambda y, x: (1 + x * x + y * y) ** -1.5, u, u + 0.25, v, v + 0.25)
    assert_close(cubemap.solid_angles(resolution)[row, column].item(), expected, rtol=1e-11, atol=0)


def test_moments_over_the_sphere() -> None:
    resolution = 128
    directions = cubemap.texel_directions(resolution)
    weights = cubemap.solid_angles(resolution).flatten().repeat(6)
    assert_close(weights @ directions, torch.zeros(3, dtype=torch.float64), rtol=0, atol=1e-12)
    second = (weights[:, None] * directions).T @ directions
    expected = 4 * math.pi / 3 * torch.eye(3, dtype=torch.float64)  # exact at texel centres by the cube's symmetry
    assert_close(second, expected, rtol=0, atol=1e-12)


# --- the plane's unknowns ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("resolution", "count"), [(1, 5), (2, 12), (3, 33), (8, 192), (16, 768), (128, 49152)])
def test_number_of_visible_texels(resolution: int, count: int) -> None:
    assert cubemap.texel_count(resolution) == count
    assert cubemap.visible_texels(resolution).shape == (count,)


@pytest.mark.parametrize("resolution", [2, 4, 16])
def test_visible_texels_are_those_whose_centre_is_above_the_horizon(resolution: int) -> None:
    above = cubemap.texel_directions(resolution, 5)[:, 2] > 0
    assert_close(cubemap.visible_texels(resolution), above.nonzero()[:, 0])


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
@pytest.mark.parametrize("resolution", [1, 3, 4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_scatter_and_gather(batch: tuple[int, ...], resolution: int, dtype: torch.dtype) -> None:
    values = 1 + torch.rand(*batch, cubemap.texel_count(resolution), dtype=dtype)
    faces = cubemap.scatter_to_faces(values, resolution)
    assert faces.shape == (*batch, 5, resolution, resolution)
    assert_close(cubemap.gather_from_faces(faces), values, rtol=0, atol=0)
    assert_close((faces == 0).sum(), torch.tensor(math.prod(batch) * (5 * resolution**2 - values.shape[-1])))


def test_scatter_fills_the_upper_half_of_the_sides() -> None:
    faces = cubemap.scatter_to_faces(torch.ones(48), 4)
    assert_close(faces[:4, :2], torch.ones(4, 2, 4))
    assert_close(faces[:4, 2:], torch.zeros(4, 2, 4))
    assert_close(faces[4], torch.ones(4, 4))


def test_gather_leaves_the_lower_face_out() -> None:
    six = torch.arange(6 * 4, dtype=torch.float64).reshape(6, 2, 2)
    assert_close(cubemap.gather_from_faces(six), cubemap.gather_from_faces(six[:5]))


def test_scatter_refuses_another_resolutions_values() -> None:
    with pytest.raises(ShapeError, match="resolution 4 has 48 visible texels, got 12"):
        cubemap.scatter_to_faces(torch.ones(12), 4)


# --- cells ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("subsamples", [1, 3, 4])
def test_cells_cover_the_hemisphere(resolution: int, subsamples: int) -> None:
    directions, solid_angles = cubemap.texel_subdirections(resolution, subsamples)
    assert_close(solid_angles.sum().item(), 2 * math.pi, rtol=1e-13, atol=0)
    assert_close(directions.norm(dim=-1), torch.ones_like(solid_angles))
    assert (directions[..., 2] > 0).all()
    cosines = cubemap.cosine_weights(resolution, subsamples)
    assert_close(cosines.sum().item(), math.pi, rtol=0, atol=1e-12)


def test_cosine_weights_sum_to_pi_at_the_finest_grid() -> None:
    assert_close(cubemap.cosine_weights(128, 4).sum().item(), math.pi, rtol=0, atol=1e-12)


@pytest.mark.parametrize("resolution", [1, 2, 3, 4])
def test_cells_add_up_to_their_texel(resolution: int) -> None:
    whole, parts = cubemap.texel_cells(resolution), cubemap.texel_cells(resolution, 3)
    for weight in (cubemap.cell_solid_angles, cubemap.cell_cosine_weights):
        assert_close(weight(parts).sum(dim=-1), weight(whole)[:, 0])


@pytest.mark.parametrize("resolution", [2, 4])
def test_cells_lie_in_their_texel(resolution: int) -> None:
    directions, solid_angles = cubemap.texel_subdirections(resolution, 3)
    visible = cubemap.visible_texels(resolution)
    assert_close(cubemap.texel_index(directions, resolution), visible[:, None].expand(-1, 9))
    expected = cubemap.solid_angles(resolution).flatten().repeat(5)[visible]
    assert_close(solid_angles.sum(dim=-1), expected)


def test_a_texels_cells_run_row_by_row_from_the_upper_left() -> None:
    _, u, v = cubemap.locate(cubemap.texel_subdirections(2, 2)[0][0])  # +x, upper left: u in [-1, 0], v in [0, 1]
    assert_close(u, vector(-0.75, -0.25, -0.75, -0.25))
    assert_close(v, vector(0.75, 0.75, 0.25, 0.25))


def test_a_straddling_texel_is_cut_above_the_horizon() -> None:
    _, _, v = cubemap.locate(cubemap.texel_subdirections(1, 2)[0][0])
    assert_close(v, vector(0.75, 0.75, 0.25, 0.25))


@pytest.mark.parametrize("resolution", [1, 3, 8])
def test_cell_weights_against_quadrature(resolution: int) -> None:
    """scipy integrates the cosine over u and v for cells of every face, the corner and the horizon included."""
    cells = cubemap.texel_cells(resolution, 2)
    solid_angles, cosines = cubemap.cell_solid_angles(cells), cubemap.cell_cosine_weights(cells)
    for index in torch.linspace(0, cells.face.numel() - 1, 13).long().tolist():
        face, left, right, bottom, top = (
            part.flatten()[index].item() for part in (cells.face, cells.left, cells.right, cells.bottom, cells.top)
        )

        def cosine(v: float, u: float, on_top: bool = face == PZ) -> float:
            return (1.0 if on_top else max(0.0, v)) / (1 + u * u + v * v) ** 2

        expected = integral(cosine, left, right, bottom, top)
        assert_close(cosines.flatten()[index].item(), expected, rtol=1e-10, atol=1e-15)
        expected = integral(lambda v, u: (1 + u * u + v * v) ** -1.5, left, right, bottom, top)
        assert_close(solid_angles.flatten()[index].item(), expected, rtol=1e-10, atol=1e-15)


def test_weights_are_means_of_the_cosine_at_cell_centres_to_second_order() -> None:
    errors = []
    for subsamples in (4, 8):
        directions, solid_angles = cubemap.texel_subdirections(2, subsamples)
        approximate = (directions[..., 2] * solid_angles).sum(dim=-1)
        errors.append((approximate - cubemap.cosine_weights(2, 1)[:, 0]).abs().max().item())
    assert_close(errors[0] / errors[1], 4.0, rtol=0.1, atol=0)


def test_gauss_nodes_integrate_solid_angle_cosine_and_moments() -> None:
    cells = cubemap.texel_cells(4)
    directions, weights = cubemap.gauss_nodes(cells, 10)
    assert_close(weights.sum(dim=-1), cubemap.cell_solid_angles(cells), rtol=1e-12, atol=0)
    assert_close((weights * directions[..., 2]).sum(dim=-1), cubemap.cell_cosine_weights(cells), rtol=1e-11, atol=0)
    second = torch.einsum("tcn,tcni,tcnj->ij", weights, directions, directions)
    expected = 2 * math.pi / 3 * torch.eye(3, dtype=torch.float64)  # the upper half of the sphere
    assert_close(second, expected, rtol=0, atol=1e-11)


def test_factories_take_a_dtype() -> None:
    directions, solid_angles = cubemap.texel_subdirections(4, 2, dtype=torch.float32)
    made = (
        cubemap.face_frames(dtype=torch.float32),
        cubemap.texel_directions(4, dtype=torch.float32),
        cubemap.solid_angles(4, dtype=torch.float32),
        cubemap.cosine_weights(4, 2, dtype=torch.float32),
    )
    assert all(tensor.dtype == torch.float32 for tensor in (directions, solid_angles, *made))
