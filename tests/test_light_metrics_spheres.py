"""Spheres under a light: furnace, literal look-ups, the cosine, and plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import axis_colours
from torchlight.light_metrics.grid import first_moments
from torchlight.light_metrics.spheres import (
    FINE,
    diffuse_sphere,
    ggx_lobe,
    matte_sphere,
    mirror_sphere,
    picture,
    reflected,
    sphere_view,
)

VIEW = sphere_view(12, (0.3, -1.0, 0.2))


def constant(height: int = 64, value: float = 2.5) -> EnvironmentMap:
    return EnvironmentMap(torch.full((3, height, 2 * height), value, dtype=torch.float64))


@pytest.mark.parametrize("height", [1, 8, 64])
def test_in_a_furnace_every_sphere_shows_the_light(height: int) -> None:
    expected = torch.full((3, len(VIEW.normals)), 2.5, dtype=torch.float64)
    assert_close(mirror_sphere(constant(height), VIEW), expected, rtol=0, atol=0)
    assert_close(matte_sphere(constant(height), VIEW), expected)
    assert_close(diffuse_sphere(constant(height), VIEW), expected, rtol=3e-4, atol=0)  # pixels that the horizon cuts


def test_the_view_from_minus_y() -> None:
    """Right is +x, up is +z, the middle looks at the viewer; the corner shows no sphere."""
    view = sphere_view(5, (0.0, -2.0, 0.0))
    normals = torch.full((5, 5, 3), math.nan, dtype=torch.float64)
    normals[view.inside] = view.normals
    assert_close(normals[2, 2], torch.tensor([0.0, -1, 0], dtype=torch.float64))
    assert_close(normals[2, 4], torch.tensor([0.8, -0.6, 0], dtype=torch.float64))
    assert_close(normals[0, 2], torch.tensor([0.0, -0.6, 0.8], dtype=torch.float64))
    assert not bool(view.inside[0, 0])
    above = sphere_view(5, (0.0, 0.0, 1.0))
    assert_close(above.normals[above.normals[:, 2].argmax()], torch.tensor([0.0, 0, 1], dtype=torch.float64))
    assert_close(above.normals[0, :2].sign(), torch.tensor([-1.0, 1.0], dtype=torch.float64))  # the top is +y


def test_a_mirror_ball_shows_the_axes_where_they_belong() -> None:
    """Seen from -y: the middle shows -y, half way to an edge's 1 / sqrt 2 show +x and +z, the rim +y from behind."""
    view = sphere_view(401, (0.0, -1.0, 0.0))
    image = picture(mirror_sphere(axis_colours(64), view), view.inside)
    colours = {"-y": (1, 0, 1), "+x": (1, 0, 0), "-x": (0, 1, 1), "+z": (0, 0, 1), "-z": (1, 1, 0), "+y": (0, 1, 0)}
    edge = round(200 * math.sqrt(0.5))
    places = {"-y": (200, 200), "+x": (200, 200 + edge), "-x": (200, 200 - edge)}
    places |= {"+z": (200 - edge, 200), "-z": (200 + edge, 200), "+y": (200, 399)}
    for name, (row, column) in places.items():
        assert_close((image[:, row, column] > 0).double(), torch.tensor(colours[name], dtype=torch.float64), msg=name)


def test_a_mirror_ball_looks_up_pixels() -> None:
    radiance = torch.arange(3 * 8 * 16, dtype=torch.float64).reshape(3, 8, 16)
    found = mirror_sphere(EnvironmentMap(radiance), VIEW)
    for index in (0, 40, 77):
        n, v = VIEW.normals[index].numpy(), VIEW.towards.numpy()
        x, y, z = 2 * (n @ v) * n - v
        row, column = int(math.acos(z) / math.pi * 8), int((0.5 - math.atan2(y, x) / (2 * math.pi)) * 16)
        assert_close(found[:, index], radiance[:, row, column])
    assert_close(torch.linalg.vector_norm(reflected(VIEW), dim=-1), torch.ones(len(VIEW.normals), dtype=torch.float64))


def test_one_bright_pixel_makes_a_cosine() -> None:
    """v = L |m| cos / pi with the pixel's first moment m: no more than its solid angle, in its direction."""
    radiance = torch.zeros(3, 64, 128, dtype=torch.float64)
    radiance[:, 20, 50] = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    sun = latlong.pixel_directions(64)[20, 50]
    moment = first_moments(64)[20 * 128 + 50]
    assert_close(moment, sun * latlong.row_solid_angles(64)[20], rtol=1e-3, atol=0)
    cosine = (VIEW.normals @ (moment / moment.norm())).clamp(min=0)
    expected = radiance[:, 20, 50][:, None] * cosine * moment.norm() / math.pi
    assert_close(diffuse_sphere(EnvironmentMap(radiance), VIEW), expected)


def test_half_a_sky_on_a_diffuse_sphere() -> None:
    """A constant upper half gives (1 + n_z) / 2."""
    radiance = torch.zeros(3, 64, 128, dtype=torch.float64)
    radiance[:, :32] = 1
    expected = ((1 + VIEW.normals[:, 2]) / 2).expand(3, -1)
    assert_close(diffuse_sphere(EnvironmentMap(radiance), VIEW), expected, rtol=0, atol=3e-4)


def test_matte_silver_against_plain_loops() -> None:
    """The microfacet formula written out with numpy scalars: f n.l, normalised."""
    radiance = torch.rand(3, FINE, 2 * FINE, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    roughness, alpha = 0.4, 0.16
    view = sphere_view(3, (0.3, -1.0, 0.2))
    found = matte_sphere(EnvironmentMap(radiance), view, roughness)
    v = view.towards.numpy()
    n = view.normals[1].numpy()
    total, weight = np.zeros(3), 0.0
    for row in range(FINE):
        theta = (row + 0.5) * math.pi / FINE
        for column in range(2 * FINE):
            phi = math.pi * (1 - (column + 0.5) / FINE)
            l = np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])
            nl, nv = float(n @ l), float(n @ v)
            if nl <= 0:
                continue
            h = (l + v) / math.sqrt((l + v) @ (l + v))
            density = alpha**2 / (math.pi * ((n @ h) ** 2 * (alpha**2 - 1) + 1) ** 2)
            lambdas = [(math.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (nl, nv)]
            brdf = density / (1 + sum(lambdas)) / (4 * nl * nv)
            part = brdf * nl * (math.cos(row * math.pi / FINE) - math.cos((row + 1) * math.pi / FINE))
            total += part * radiance[:, row, column].numpy()
            weight += part
    assert found[:, 1].tolist() == pytest.approx((total / weight).tolist(), rel=1e-6)


def test_a_smooth_lobe_is_nearly_a_mirror_and_light_from_behind_counts_nothing() -> None:
    view = sphere_view(3, (0.0, -1.0, 0.0))
    radiance = torch.zeros(3, 64, 128, dtype=torch.float64)
    middle = latlong.pixel_indices(torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64), 64)
    row, column = (int(index) for index in middle)
    radiance[:, row - 3 : row + 4, column - 3 : column + 4] = 1
    centre = matte_sphere(EnvironmentMap(radiance), view, 0.1)[:, 4]
    assert 0.97 < float(centre.min()) < 1  # D leaves a^2 / (a^2 + tan^2 5°) = 0.013 outside
    rough = matte_sphere(EnvironmentMap(radiance), view, 1.0)[:, 4]
    assert float(rough.max()) < 0.1
    below, half = (torch.tensor([[value]], dtype=torch.float64) for value in (-0.1, 0.5))
    behind = ggx_lobe(below, half, half, 0.1)
    assert float(behind) == 0


def test_a_batch_of_lights_and_each_alone() -> None:
    radiance = torch.rand(2, 3, 8, 16, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    for sphere in (mirror_sphere, diffuse_sphere, matte_sphere):
        found = sphere(EnvironmentMap(radiance), VIEW)
        assert_close(found[1], sphere(EnvironmentMap(radiance[1]), VIEW))


def test_bad_settings() -> None:
    with pytest.raises(ConfigError, match="direction"):
        sphere_view(4, (0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="pixel"):
        sphere_view(0, (0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match="roughness"):
        matte_sphere(constant(1), VIEW, 0.0)
