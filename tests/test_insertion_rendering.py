"""An object in a photograph: closed forms, and the project's own relighting as the other implementation."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.camera import Camera, pixel_directions, project
from torchlight.errors import CalibrationError, ConfigError, SceneError
from torchlight.geometry.primitives import box, sphere
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.insertion.placing import stood
from torchlight.insertion.rendering import Insertion, Rendering, insert
from torchlight.insertion.shading import Material
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.light_plane import LightPlane
from torchlight.relighting import relight

SIZE = (40, 30)
PLANE = Receiver((0.0, 0.0), (4.0, 3.0), SIZE, (0.8, 0.8, 0.8))
NOTHING = torch.zeros(0, 3, 3, dtype=torch.float64)
WHITE = Material((1.0, 1.0, 1.0))
FEW = Rendering(rays=1024)
SKY = EnvironmentMap(torch.ones(3, 8, 16))


def looking(size: tuple[int, int] = SIZE, distance: float = 7.0) -> Camera:
    """A camera at 45 degrees with a little distortion."""
    half = 0.5**0.5
    axes = torch.tensor([[1.0, 0, 0], [0, -half, -half], [0, half, -half]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = axes
    pose[2, 3] = distance
    width, height = size
    k = torch.tensor([[1.4 * width, 0, (width - 1) / 2], [0, 1.4 * width, (height - 1) / 2], [0, 0, 1]])
    return Camera(k.double(), pose, size, torch.tensor([-0.05, 0.01, 0.0, 0.0, 0.0], dtype=torch.float64))


def grey(size: tuple[int, int] = SIZE, seed: int = 0) -> Tensor:
    """A photograph with a pattern."""
    generator = torch.Generator().manual_seed(seed)
    return 0.2 + 0.6 * torch.rand(3, size[1], size[0], generator=generator)


def one_pixel_sun(row: int = 20, column: int = 170, rows: int = 128) -> EnvironmentMap:
    radiance = torch.zeros(3, rows, 2 * rows, dtype=torch.float64)
    radiance[:, row, column] = torch.tensor([3000.0, 2000.0, 1000.0], dtype=torch.float64)
    return EnvironmentMap(radiance)


def sun_direction(row: int = 20, column: int = 170, rows: int = 128) -> Tensor:
    theta, phi = math.pi * (row + 0.5) / rows, math.pi * (1 - (column + 0.5) / rows)
    level = math.sin(theta)
    return torch.tensor([level * math.cos(phi), level * math.sin(phi), math.cos(theta)], dtype=torch.float64)


def sphere_normals(camera: Camera, center: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Normals of an exact sphere at the pixels whose centres see it, and these pixels, flat."""
    width, height = camera.image_size
    index = torch.arange(width * height)
    d = pixel_directions(camera, torch.stack([index % width, index // width], dim=-1).double())
    offset = camera.position - center
    half = (d * offset).sum(dim=-1)
    inner = half**2 - (offset @ offset - (0.8 * radius) ** 2)  # not near the rim
    seen = inner > 0
    depth = -half - (half**2 - (offset @ offset - radius**2)).clamp(min=0).sqrt()
    points = camera.position + depth[:, None] * d
    return ((points - center) / radius)[seen], seen


def fine_sphere(height: float = 2.0, radius: float = 0.8) -> Tensor:
    return sphere(radius, 96) + torch.tensor([0.0, 0.0, height - radius]).double()


def shaded(light: EnvironmentMap, material: Material = WHITE, rendering: Rendering = FEW) -> tuple[Insertion, Tensor]:
    """A hovering sphere, and its exact normals at the pixels well within it."""
    camera = looking()
    made = insert(torch.zeros(3, 30, 40), Scene(NOTHING, PLANE, camera), light, fine_sphere(), material, rendering)
    normals, seen = sphere_normals(camera, torch.tensor([0.0, 0.0, 2.0]).double(), 0.8)
    assert int(seen.sum()) > 50
    assert (made.coverage.flatten()[seen] == 1).all()
    return made, torch.cat([normals.T, made.composite.flatten(start_dim=1)[:, seen].double()])


# --- the object ----------------------------------------------------------------------------------------------------


def test_furnace_a_diffuse_object_shows_albedo_times_light_times_the_sky_it_sees() -> None:
    material = Material((0.9, 0.5, 0.1))
    _, found = shaded(EnvironmentMap(torch.full((3, 8, 16), 2.0)), material)
    sky = (1 + found[2]) / 2  # of a plane that hides half of it
    expected = torch.tensor(material.albedo, dtype=torch.float64)[:, None] * 2.0 * sky
    assert_close(found[3:], expected, rtol=0, atol=0.02)  # a pixel covers some degrees of the sphere


def test_lambert_s_cosine_under_a_sun_of_one_pixel() -> None:
    light = one_pixel_sun()
    made, found = shaded(light)
    cosine = (sun_direction() @ found[:3]).clamp(min=0)
    solid = (math.pi / 128) * 2 * math.sin(math.pi / 256) * math.sin(math.pi * 20.5 / 128)
    level = torch.tensor([3000.0, 2000.0, 1000.0]).double()[:, None] * solid / math.pi
    assert (cosine > 0.3).any()
    assert_close(found[3:], level * cosine, rtol=0, atol=0.03 * level.max().item())
    assert made.coverage.sum() > 50


def test_the_object_is_linear_in_the_light_and_the_gloss_a_share() -> None:
    sun, sky = sun_and_window(32), EnvironmentMap(torch.full((3, 32, 64), 0.3, dtype=torch.float64))
    diffuse, glossy = shaded(sun)[1][3:], shaded(sun, Material((1.0, 1.0, 1.0), 1.0, 0.3))[1][3:]
    both = shaded(sun, Material((1.0, 1.0, 1.0), 0.25, 0.3))[1][3:]
    assert_close(both, 0.75 * diffuse + 0.25 * glossy, rtol=1e-5, atol=1e-6)
    doubled = shaded(replace(sun, radiance=2 * sun.radiance))[1][3:]
    assert_close(doubled, 2 * diffuse, rtol=1e-5, atol=1e-6)
    together = shaded(replace(sun, radiance=sun.radiance + sky.radiance))[1][3:]
    apart = diffuse + shaded(sky)[1][3:]
    assert_close(together, apart, rtol=0, atol=0.02 * apart.max().item())  # other directions


def test_the_plane_s_bounce_lights_what_faces_it() -> None:
    # a small sphere over a plane of radiance 0.8, which its own shadow hardly darkens: (1 + z) / 2 + 0.8 (1 - z) / 2
    camera = looking((80, 60))
    small = sphere(0.3, 48) + torch.tensor([0.0, 0.0, 1.7]).double()
    made = insert(
        torch.zeros(3, 60, 80), Scene(NOTHING, PLANE, camera), SKY, small, WHITE, Rendering(rays=1024, bounce=True)
    )
    normals, seen = sphere_normals(camera, torch.tensor([0.0, 0.0, 2.0]).double(), 0.3)
    z = normals[:, 2]
    assert int(seen.sum()) > 40
    found = made.composite.flatten(start_dim=1)[0, seen].double()
    assert_close(found, (1 + z) / 2 + 0.8 * (1 - z) / 2, rtol=0, atol=0.03)


# --- its shadow ----------------------------------------------------------------------------------------------------


def test_the_shadow_is_the_ratio_of_relight_with_and_without() -> None:
    # seen from above, one pixel per sample of the receiver
    old = stood(box((0.5, 0.5, 0.6)), (-0.8, 0.0))
    plate = box((0.8, 0.8, 0.02)) + torch.tensor([0.5, 0.2, 0.7]).double()
    light = sun_and_window(32)
    scene = Scene(old, PLANE)
    photo = grey().double()
    made = insert(photo, scene, light, plate, WHITE, Rendering(rays=4096))
    before = relight(scene, light, 8192).reshape(3, 30, 40).flip(1)
    after = relight(replace(scene, triangles=torch.cat([old, plate])), light, 8192).reshape(3, 30, 40).flip(1)
    xy = torch.stack(
        torch.meshgrid((torch.arange(40) + 0.5) / 10 - 2, 1.5 - (torch.arange(30) + 0.5) / 10, indexing="xy")
    )
    on_old = ((xy[0] + 0.8).abs() < 0.35) & (xy[1].abs() < 0.35)
    free = (made.coverage == 0) & ~on_old
    assert int(free.sum()) > 900
    assert (made.ratio[:, free] < 0.6).any()
    assert_close(made.ratio[:, free], (after / before)[:, free], rtol=0, atol=0.03)  # two sets of directions
    assert_close(made.composite[:, free], (photo * made.ratio)[:, free])


def test_pixels_out_of_the_shadow_s_reach_are_bit_identical() -> None:
    # a sun of one pixel: what the object neither covers nor shades keeps its bits; far away it shades nothing
    photo = grey()
    scene = Scene(stood(box((0.5, 0.5, 0.6))), PLANE, looking())
    made = insert(photo, scene, one_pixel_sun(), stood(box((0.4, 0.4, 0.4)), (0.9, -0.6)), WHITE, FEW)
    same = (made.coverage == 0) & (made.ratio == 1).all(dim=0)
    assert 0.5 < same.double().mean().item() < 0.99
    assert torch.equal(made.composite[:, same], photo[:, same])
    assert not made.changed[same].any()
    away = insert(photo, scene, one_pixel_sun(), stood(box((0.4, 0.4, 0.4)), (90.0, 60.0)), WHITE, FEW)
    assert torch.equal(away.composite, photo)


def test_the_umbra_of_the_only_sun_is_black_and_where_it_should_be() -> None:
    light = one_pixel_sun()
    plate = box((1.0, 1.0, 0.001)) + torch.tensor([0.0, 0.0, 0.8]).double()
    made = insert(torch.ones(3, 30, 40), Scene(NOTHING, PLANE), light, plate, WHITE, FEW)
    d = sun_direction()
    shift = (-0.8 * d[:2] / d[2]).tolist()
    x, y = torch.meshgrid((torch.arange(40) + 0.5) / 10 - 2, 1.5 - (torch.arange(30) + 0.5) / 10, indexing="xy")
    within = torch.maximum((x - shift[0]).abs(), (y - shift[1]).abs())
    bare = made.coverage == 0
    umbra, lit = bare & (within < 0.4), bare & (within > 0.6)
    assert int(umbra.sum()) > 10
    assert made.ratio[:, umbra].max().item() < 1e-6
    assert torch.equal(made.ratio[:, lit], torch.ones_like(made.ratio[:, lit]))


def test_the_shadow_falls_on_objects_that_are_there() -> None:
    light = one_pixel_sun(row=2)  # nearly overhead
    block = stood(box((1.6, 1.2, 0.5)))
    plate = box((0.5, 0.5, 0.01)) + torch.tensor([0.0, 0.0, 2.2]).double()
    camera = looking(distance=5.0)
    made = insert(torch.ones(3, 30, 40), Scene(block, PLANE, camera), light, plate, WHITE, FEW)
    lid = project(camera, torch.tensor([[0.0, 0.0, 0.5]]).double())[0].round().long().tolist()
    assert made.coverage[lid[1], lid[0]] == 0
    assert made.ratio[0, lid[1], lid[0]] < 0.1


def test_objects_in_front_hide_the_new_one() -> None:
    behind = stood(box((0.4, 0.4, 0.4)), (0.0, 0.6))
    wall = stood(box((3.0, 0.1, 2.0)), (0.0, -0.2))
    camera = looking()
    photo = grey()
    alone = insert(photo, Scene(NOTHING, PLANE, camera), SKY, behind, WHITE, Rendering(rays=64))
    hidden = insert(photo, Scene(wall, PLANE, camera), SKY, behind, WHITE, Rendering(rays=64))
    assert alone.coverage.max() == 1
    assert hidden.coverage.max() == 0


def test_the_plane_may_end_with_the_receiver() -> None:
    small = replace(PLANE, size=(0.6, 0.6))
    camera = looking()
    thing = stood(box((0.5, 0.5, 0.8)))
    wide, narrow = (
        insert(grey(), Scene(NOTHING, small, camera), SKY, thing, WHITE, Rendering(rays=256, only_receiver=only))
        for only in (False, True)
    )
    assert (wide.ratio < 0.999).sum() > (narrow.ratio < 0.999).sum() > 0


def test_superposition_two_lights_are_the_sum_of_one_by_one() -> None:
    # irradiances add: r (E1 + E2) = r1 E1 + r2 E2, checked on light that the plane itself shows
    scene = Scene(NOTHING, PLANE)
    first, second = one_pixel_sun(), one_pixel_sun(30, 150)
    thing = stood(box((0.6, 0.6, 0.5)))
    lights = (first, second, EnvironmentMap(first.radiance + second.radiance))
    levels = [relight(scene, light, 1024).mean(dim=1)[:, None, None] for light in lights]
    composites = [
        insert(torch.ones(3, 30, 40, dtype=torch.float64) * level, scene, light, thing, WHITE, FEW).composite
        for level, light in zip(levels, lights, strict=True)
    ]
    difference = (composites[2] - composites[0] - composites[1]).abs() / levels[2]
    assert difference.mean().item() < 2e-3
    assert difference.quantile(0.98).item() < 0.02  # at the edges of shadows, other directions


# --- brightness, near light, what cannot be -------------------------------------------------------------------------


def test_brightness_is_what_the_photograph_shows_of_what_the_light_says() -> None:
    light = sun_and_window(32)
    scene = Scene(NOTHING, PLANE)
    photo = 0.5 * relight(scene, light, 8192).reshape(3, 30, 40).flip(1)
    thing = stood(box((0.3, 0.3, 0.3)))
    plain, fitted = (
        insert(photo, scene, light, thing, WHITE, Rendering(4096, fit_brightness=fit)) for fit in (False, True)
    )
    assert_close(plain.brightness, torch.full((3,), 0.5, dtype=torch.float64), rtol=0.01, atol=0)
    whole = plain.coverage == 1
    assert_close(fitted.composite[:, whole], 0.5 * plain.composite[:, whole], rtol=0.01, atol=0)


def test_brightness_is_that_of_the_receiver_whatever_lies_beyond() -> None:
    camera, light = looking((80, 60)), sun_and_window(32)
    small = replace(PLANE, size=(1.0, 1.0), samples=(10, 10))
    scene = Scene(NOTHING, small, camera)
    level = relight(Scene(NOTHING, small), light, 8192).mean(dim=1)[:, None, None]
    index = torch.arange(80 * 60)
    rays = pixel_directions(camera, torch.stack([index % 80, index // 80], dim=-1).double())
    points = camera.position - rays * (camera.position[2] / rays[:, 2:])
    inside = (points[:, :2].abs() < 0.6).all(dim=-1).reshape(60, 80)
    assert 0.01 < inside.double().mean() < 0.3
    photo = torch.where(inside, 0.5 * level, 0.0)
    made = insert(photo, scene, light, stood(box((0.1, 0.1, 0.1))), WHITE, Rendering(4096))
    assert_close(made.brightness, torch.full((3,), 0.5, dtype=torch.float64), rtol=0.02, atol=0)


def test_a_near_light_s_shadow_is_that_of_relight() -> None:
    plane = LightPlane(3.0)
    light = replace(sun_and_window(32), plane=plane)
    thing = stood(box((0.5, 0.5, 0.6)))
    made = insert(torch.ones(3, 30, 40).double(), Scene(NOTHING, PLANE), light, thing, WHITE, Rendering(4096))
    after = relight(Scene(thing, PLANE), light, 8192).reshape(3, 30, 40).flip(1)
    before = relight(Scene(NOTHING, PLANE), light, 8192).reshape(3, 30, 40).flip(1)
    free = made.coverage == 0
    assert_close(made.ratio[:, free], (after / before)[:, free], rtol=0, atol=0.03)


def test_a_light_that_stands_elsewhere_is_refused() -> None:
    scene = Scene(NOTHING, PLANE, light_plane=LightPlane(5.0))
    with pytest.raises(SceneError, match="the scene says that its light stands"):
        insert(grey(), scene, SKY, stood(box((0.5, 0.5, 0.5))), WHITE, FEW)


def test_a_photograph_of_another_size_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"the photograph has 20 x 30 pixels but camera.image_size says 40 x 30"):
        insert(torch.zeros(3, 30, 20), Scene(NOTHING, PLANE, looking()), SKY, stood(box((0.5, 0.5, 0.5))))


def test_what_lies_below_the_plane_is_refused_with_how_far() -> None:
    sunk = box((1.0, 1.0, 1.0)) - torch.tensor([0.0, 0.0, 0.25]).double()
    with pytest.raises(SceneError, match=r"lies 0.25 below the plane .* raise it by 0.25"):
        insert(grey(), Scene(NOTHING, PLANE), SKY, sunk)


@pytest.mark.parametrize("triangles", [NOTHING, torch.full((1, 3, 3), torch.nan, dtype=torch.float64)])
def test_no_faces_and_no_numbers_are_refused(triangles: Tensor) -> None:
    with pytest.raises(SceneError, match=r"no faces|NaN"):
        insert(grey(), Scene(NOTHING, PLANE), SKY, triangles)


def test_an_albedo_above_one_is_relative_or_wrong() -> None:
    bright = Material((1.2, 1.0, 1.0))
    thing = stood(box((0.5, 0.5, 0.5)))
    with pytest.raises(ConfigError, match="the plane's own albedo is stated"):
        insert(grey(), Scene(NOTHING, PLANE), SKY, thing, bright, Rendering(rays=16))
    insert(grey(), Scene(NOTHING, replace(PLANE, albedo=None)), SKY, thing, bright, Rendering(rays=16))
