"""Cube maps in one picture: continuity across hinges, literal directions, and OpenGL's own table."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.light import cubemap
from torchlight.light.directions import to_z_up
from torchlight.light.layouts import LAYOUTS, face_edge, faces_to_picture, picture_to_faces

SIZE = 6


def directions_in(name: str, resolution: int = SIZE) -> torch.Tensor:
    """Y-up directions of a layout's pixels, not normalised; 0 outside its faces."""
    faces = cubemap.texel_directions(resolution).T.reshape(3, 6, resolution, resolution)
    x, y, z = faces_to_picture(faces, name)
    return torch.stack([x, z, -y], dim=-1)


@pytest.mark.parametrize("name", LAYOUTS)
def test_faces_and_pictures_round_trip(name: str) -> None:
    faces = torch.rand(2, 6, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    picture = faces_to_picture(faces, name)
    assert picture.shape == (2, LAYOUTS[name].rows * SIZE, LAYOUTS[name].columns * SIZE)
    assert torch.equal(picture_to_faces(picture, name), faces)
    assert int((picture > 0).sum()) == 2 * 6 * SIZE**2


@pytest.mark.parametrize("name", LAYOUTS)
def test_captions_are_not_light(name: str) -> None:
    faces = torch.rand(6, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    picture = faces_to_picture(faces, name)
    assert torch.equal(picture_to_faces(torch.where(picture > 0, picture, 1e9), name), faces)


@pytest.mark.parametrize(
    ("name", "hinges"),
    [
        ("cross", [("row", 0, 1), ("row", 1, 1), ("row", 2, 1), ("column", 1, 0), ("column", 1, 1)]),
        ("horizontal-cross", [("row", 0, 1), ("row", 1, 1), ("column", 1, 0), ("column", 1, 1), ("column", 1, 2)]),
    ],
)
def test_crosses_are_folded_along_their_hinges(name: str, hinges: list[tuple[str, int, int]]) -> None:
    """Neighbouring pixels look in neighbouring directions where two faces touch in the picture."""
    directions = directions_in(name)
    step = (directions[SIZE, SIZE] - directions[SIZE + 1, SIZE]).norm()
    for way, row, column in hinges:
        block = slice(SIZE * row, SIZE * (row + 1)), slice(SIZE * column, SIZE * (column + 1))
        if way == "row":  # the face below
            one, other = directions[block][-1], directions[SIZE * (row + 1), block[1]]
        else:  # the face to the right
            one, other = directions[block][:, -1], directions[block[0], SIZE * (column + 1)]
        assert bool(((one - other).norm(dim=-1) < 2 * step).all())


@pytest.mark.parametrize("name", ["cross", "horizontal-cross"])
def test_the_middle_of_a_cross_looks_along_minus_z_with_x_to_the_right_and_y_up(name: str) -> None:
    middle = directions_in(name)[SIZE : 2 * SIZE, SIZE : 2 * SIZE]
    assert bool((middle[..., 2] < 0).all())
    assert bool((middle.diff(dim=1)[..., 0] > 0).all())
    assert bool((middle.diff(dim=0)[..., 1] < 0).all())
    world = to_z_up(middle.mean(dim=(0, 1)))
    assert_close(world / world.norm(), torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["strip", "opengl-strip"])
def test_strips_hold_the_faces_in_the_order_of_their_axes(name: str) -> None:
    centres = directions_in(name).reshape(SIZE, 6, SIZE, 3).mean(dim=(0, 2))
    axes = torch.eye(3, dtype=torch.float64)[[0, 0, 1, 1, 2, 2]] * torch.tensor([1, -1] * 3)[:, None]
    assert_close(centres / centres.norm(dim=1, keepdim=True), axes, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "sign"), [("strip", 1), ("horizontal-cross", 1), ("cross", 1), ("opengl-strip", -1)])
def test_only_opengls_faces_are_mirrored(name: str, sign: int) -> None:
    """Seen from inside, right x up points backwards, towards the eye."""
    layout = LAYOUTS[name]
    right, up = (torch.tensor(rows, dtype=torch.float64) for rows in (layout.right, layout.up))
    forward = torch.eye(3, dtype=torch.float64)[[0, 0, 1, 1, 2, 2]] * torch.tensor([1, -1] * 3)[:, None]
    assert_close(torch.linalg.cross(right, up), -sign * forward, rtol=0, atol=0)


def test_an_opengl_shader_finds_the_light() -> None:
    """texture(cube, d) by the table of the specification: major axis, s_c, t_c, m_a; s = (s_c / m + 1) / 2."""
    generator = torch.Generator().manual_seed(0)
    faces = torch.rand(6, SIZE, SIZE, dtype=torch.float64, generator=generator)
    strip = faces_to_picture(faces, "opengl-strip").reshape(SIZE, 6, SIZE).transpose(0, 1)
    for x, y, z in torch.randn(300, 3, dtype=torch.float64, generator=generator).tolist():
        table = ((x, -z, -y), (-x, z, -y), (y, x, z), (-y, x, -z), (z, x, -y), (-z, -x, -y))
        face = max(range(6), key=lambda f: table[f][0])
        major, s, t = table[face]
        row, column = (int((value / major + 1) / 2 * SIZE) for value in (t, s))
        here = cubemap.texel_index(to_z_up(torch.tensor([x, y, z], dtype=torch.float64)), SIZE)
        assert strip[face, row, column] == faces.reshape(-1)[here]


def test_a_strip_is_the_horizontal_cross_cut_up() -> None:
    faces = torch.rand(6, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    strip = faces_to_picture(faces, "strip").reshape(SIZE, 6, SIZE)
    cross = faces_to_picture(faces, "horizontal-cross").reshape(3, SIZE, 4, SIZE)
    for face, (row, column) in enumerate(LAYOUTS["horizontal-cross"].places):
        assert torch.equal(strip[:, face], cross[row, :, column])


@pytest.mark.parametrize(("name", "shape"), [("cross", (9, 8)), ("strip", (4, 25)), ("horizontal-cross", (0, 0))])
def test_pictures_of_another_shape_are_refused(name: str, shape: tuple[int, int]) -> None:
    with pytest.raises(ShapeError, match=f"{name}: expected"):
        face_edge(name, *shape)
