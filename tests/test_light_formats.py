from __future__ import annotations

import math

import pytest
import torch
from realdata import data_path
from torch.testing import assert_close

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.io.rgbe import read_hdr
from torchlight.light import cubemap, formats, latlong
from torchlight.light.angular import angular_coordinates, angular_solid_angles
from torchlight.light.directions import to_y_up, to_z_up
from torchlight.light.environment import EnvironmentMap, power
from torchlight.light.overlap import cubemap_to_latlong
from torchlight.light.procedural import axis_colours

HEIGHT = 16


def _smooth(directions: torch.Tensor) -> torch.Tensor:
    """A smooth function without any symmetry."""
    x, y, z = directions.unbind(-1)
    return torch.stack([1 + 0.5 * x + 0.2 * y * z, 1 - 0.4 * y + 0.3 * x * z, 1 + 0.6 * z + 0.3 * x * y])


def _their_directions(convention: str) -> torch.Tensor:
    """Directions, in each library's own axes, of pixel centres of its own lat-long: from its published formula."""
    v = (torch.arange(HEIGHT, dtype=torch.float64)[:, None] + 0.5) / HEIGHT * math.pi
    u = (torch.arange(2 * HEIGHT, dtype=torch.float64) + 0.5) / (2 * HEIGHT)
    v, u = torch.broadcast_tensors(v, u)
    sine, up = v.sin(), v.cos()
    if convention == "threejs":  # equirectUv: u = atan(z, x) / 2 pi + 1/2
        longitude = (u - 0.5) * 2 * math.pi
        return torch.stack([sine * longitude.cos(), up, sine * longitude.sin()], -1)
    if (
        convention == "openexr"
    ):  # ImfEnvmap: longitude = -(2 pi (u - 1/2)), (sin long cos lat, sin lat, cos long cos lat)
        longitude = -2 * math.pi * (u - 0.5)
        return torch.stack([sine * longitude.sin(), up, sine * longitude.cos()], -1)
    if convention == "skylibs":  # latlong2world: theta = pi (2 u - 1), (sin phi sin theta, cos phi, -sin phi cos theta)
        theta = math.pi * (2 * u - 1)
        return torch.stack([sine * theta.sin(), up, -sine * theta.cos()], -1)
    raise AssertionError(convention)


@pytest.mark.parametrize("convention", ["threejs", "openexr", "skylibs"])
def test_conventions_agree_with_their_published_formulas(convention):
    theirs = _smooth(to_z_up(_their_directions(convention)))
    ours = _smooth(latlong.pixel_directions(HEIGHT))
    assert_close(formats.from_latlong(theirs, convention), ours, atol=1e-12, rtol=0)
    assert_close(formats.to_latlong(ours, convention), theirs, atol=1e-12, rtol=0)


def test_axes_land_on_the_documented_columns():
    colours = axis_colours(HEIGHT).radiance[:, HEIGHT // 2]
    red, green = [colours[c] * (colours[1 - c] == 0) * (colours[2] == 0) for c in (0, 1)]

    def column(name: str, mask: torch.Tensor) -> float:
        picture = formats.to_latlong(mask.expand(HEIGHT, -1), name)[0]
        return (torch.nonzero(picture > 0).double().mean().item() + 0.5) / (2 * HEIGHT)

    assert column("torchlight", red) == pytest.approx(0.5)
    assert column("torchlight", green) == pytest.approx(0.25)
    assert column("openexr", red) == pytest.approx(0.25)
    assert column("skylibs", red) == pytest.approx(0.75)
    assert column("skylibs", green) == pytest.approx(0.5)


@pytest.mark.parametrize("convention", formats.CONVENTIONS)
def test_conventions_round_trip(convention):
    image = torch.rand(2, 3, 4, 8, generator=torch.Generator().manual_seed(0))
    assert_close(formats.from_latlong(formats.to_latlong(image, convention), convention), image, atol=0, rtol=0)


def test_synonyms_are_synonyms():
    image = axis_colours(HEIGHT).radiance
    for names in (("torchlight", "blender", "threejs"), ("openexr", "usd", "mitsuba")):
        for name in names[1:]:
            assert_close(formats.to_latlong(image, name), formats.to_latlong(image, names[0]), atol=0, rtol=0)


def test_frames():
    axes = torch.eye(3)
    assert to_z_up(axes).tolist() == [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    assert_close(to_y_up(to_z_up(axes)), axes)


def test_kinds_are_told_apart_by_shape():
    assert formats.kind_of(512, 1024) == "latlong"
    assert formats.kind_of(1024, 768) == "cross"
    assert formats.kind_of(640, 640) == "angular"
    with pytest.raises(FormatError, match="crop or resample"):
        formats.kind_of(600, 800)


def test_bad_requests_are_refused():
    with pytest.raises(ConfigError, match="choose one of torchlight"):
        formats.from_latlong(torch.zeros(4, 8), "panorama")
    with pytest.raises(ShapeError, match="quarter turn"):
        formats.from_latlong(torch.zeros(3, 6), "openexr")
    with pytest.raises(ShapeError, match="cross: expected 3 F x 4 F"):
        formats.cross_to_cubemap(torch.zeros(8, 8))
    with pytest.raises(ShapeError, match="square"):
        formats.angular_to_latlong(torch.zeros(8, 16))


# --- cross ---------------------------------------------------------------------------------------------------------


def _cross_directions(resolution: int) -> tuple[torch.Tensor, torch.Tensor]:
    """World directions of the cross's pixels, built by folding the cross: turn from face to face about its hinges."""
    grid = (2 * torch.arange(resolution, dtype=torch.float64) + 1) / resolution - 1
    v, u = torch.meshgrid(-grid, grid, indexing="ij")
    front = {"right": (1, 0, 0), "up": (0, 1, 0), "forward": (0, 0, -1)}
    right, up, forward = (torch.tensor(front[k], dtype=torch.float64) for k in ("right", "up", "forward"))
    frames = {
        (1, 1): (right, up, forward),
        (1, 0): (forward, up, -right),
        (1, 2): (-forward, up, right),
        (0, 1): (right, -forward, up),
        (2, 1): (right, forward, -up),
        (3, 1): (right, -up, -forward),
    }
    directions = torch.zeros(4 * resolution, 3 * resolution, 3, dtype=torch.float64)
    inside = torch.zeros(4 * resolution, 3 * resolution, dtype=torch.bool)
    for (row, column), (r, w, f) in frames.items():
        block = slice(row * resolution, (row + 1) * resolution), slice(column * resolution, (column + 1) * resolution)
        directions[block] = torch.nn.functional.normalize(f + u[..., None] * r + v[..., None] * w, dim=-1)
        inside[block] = True
    return to_z_up(directions), inside


def test_a_cross_painted_from_directions_is_read_exactly():
    directions, inside = _cross_directions(8)
    image = torch.where(inside, _smooth(directions), 1e9)
    faces = formats.cross_to_cubemap(image)
    assert_close(faces.flatten(1), _smooth(cubemap.texel_directions(8)), atol=1e-12, rtol=0)
    # an average by area; the two ways to it balance differently
    assert_close(formats.cross_to_latlong(image), cubemap_to_latlong(faces, 16), atol=1e-5, rtol=0)
    assert_close(formats.cross_to_latlong(image), _smooth(latlong.pixel_directions(16)), atol=0.08, rtol=0)


def _edge_steps(cross: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Mean log step across each of the 12 cube edges, and between neighbours one texel inside all faces."""
    faces = formats.cross_to_cubemap(cross)
    resolution = faces.shape[-1]
    logs = (faces.mean(0) + 1e-3).log().reshape(-1)
    position = (2 * torch.arange(resolution, dtype=torch.float64) + 1) / resolution - 1
    just = 1 - 1 / resolution
    steps = []
    for first in range(3):
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            axes = [axis for axis in range(3) if axis != first]
            sides = []
            for near, far in ((1.0, just), (just, 1.0)):
                points = torch.zeros(resolution, 3, dtype=torch.float64)
                points[:, first] = position
                points[:, axes[0]], points[:, axes[1]] = signs[0] * near, signs[1] * far
                sides.append(logs[cubemap.texel_index(points, resolution)])
            steps.append((sides[0] - sides[1]).abs().mean())
    inner = logs.reshape(faces.shape[1:]).diff(dim=-1).abs().mean().item()
    return torch.stack(steps), inner


@pytest.mark.parametrize("name", ["kitchen_cross.hdr", "campus_cross.hdr"])
def test_real_crosses_are_continuous_across_all_twelve_edges(name):
    cross = read_hdr(data_path("probes", name)).double()
    steps, inner = _edge_steps(cross)
    assert len(steps) == 12
    assert steps.max().item() < 3 * inner
    resolution = cross.shape[-1] // 3
    turned = cross.clone()
    block = slice(3 * resolution, 4 * resolution), slice(resolution, 2 * resolution)
    turned[:, block[0], block[1]] = cross[:, block[0], block[1]].flip(-1, -2)
    assert _edge_steps(turned)[0].max().item() > 5 * inner


def test_cross_and_angular_map_of_the_same_place_agree_and_keep_their_energy():
    # Binned, which turns nothing and saves seconds.
    stored_cross = torch.nn.functional.avg_pool2d(read_hdr(data_path("probes", "campus_cross.hdr")), 4)
    stored_disc = torch.nn.functional.avg_pool2d(read_hdr(data_path("probes", "campus_probe.hdr")), 2)
    cross, disc = formats.cross_to_latlong(stored_cross), formats.angular_to_latlong(stored_disc)
    faces = formats.cross_to_cubemap(stored_cross).double()
    cross_power = (faces * cubemap.solid_angles(faces.shape[-1])).sum((-3, -2, -1))
    assert_close(power(EnvironmentMap(cross)).double(), cross_power, atol=0, rtol=1e-5)
    disc_power = (stored_disc.double() * angular_solid_angles(stored_disc.shape[-1])).sum((-2, -1))
    assert_close(power(EnvironmentMap(disc)).double(), disc_power, atol=0, rtol=1e-4)

    def pattern(image: torch.Tensor) -> torch.Tensor:
        grey = (image.mean(0) + 1e-3).log()
        small = torch.nn.functional.interpolate(grey[None, None], size=(64, 128), mode="area")[0, 0]
        return (small - small.mean()) / small.std()

    first, second = pattern(cross), pattern(disc)
    agreement = [(first * second.roll(shift, dims=-1)).mean().item() for shift in range(128)]
    mirrored = [(first * second.flip(-1).roll(shift, dims=-1)).mean().item() for shift in range(128)]
    assert agreement[0] == max(agreement)
    assert agreement[0] > 0.99
    assert max(mirrored) < 0.9


# --- angular map ---------------------------------------------------------------------------------------------------


def test_angular_map_follows_the_published_description():
    """Centre straight ahead (-Z of the probe), rim behind, angle from the centre linear in the radius, no mirror."""
    angle = torch.tensor([0.2, 1.0, 2.0, 3.0], dtype=torch.float64)
    for turn, expected in ((0.0, (1, 0)), (math.pi / 2, (0, 1)), (2.5, (math.cos(2.5), math.sin(2.5)))):
        probe = torch.stack([angle.sin() * math.cos(turn), angle.sin() * math.sin(turn), -angle.cos()], dim=-1)
        u, v = angular_coordinates(to_z_up(probe))
        assert_close(u, angle / math.pi * expected[0], atol=1e-12, rtol=0)
        assert_close(v, angle / math.pi * expected[1], atol=1e-12, rtol=0)
    u, v = angular_coordinates(torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64))
    assert_close(torch.stack([u, v]), torch.zeros(2, dtype=torch.float64))
    u, v = angular_coordinates(torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64))  # straight behind: on the rim
    assert_close(torch.hypot(u, v).item(), 1.0)


@pytest.mark.parametrize("size", [63, 64])
def test_an_angular_map_painted_from_directions_is_read_back(size):
    position = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    v, u = torch.meshgrid(-position, position, indexing="ij")
    angle, turn = math.pi * torch.hypot(u, v), torch.atan2(v, u)
    probe = torch.stack([angle.sin() * turn.cos(), angle.sin() * turn.sin(), -angle.cos()], dim=-1)
    image = torch.where(angle <= math.pi, _smooth(to_z_up(probe)), 1e6)
    result = formats.angular_to_latlong(image)
    assert result.shape == (3, 64, 128)
    # ahead, a pixel is twice as large as one of the lat-long, and constant: half of one's width times the slope
    assert_close(result, _smooth(latlong.pixel_directions(64)), atol=0.025, rtol=0)


def test_angular_solid_angles_fill_the_sphere():
    assert_close(angular_solid_angles(500).sum().item(), 4 * math.pi, atol=0, rtol=1e-5)
