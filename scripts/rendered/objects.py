"""What a photograph shows, as Mitsuba takes it: a plane, a block, distant light. The world is torchlight's, Z up."""

from __future__ import annotations

from typing import Any

from paper.mitsuba_truth import constant_per_pixel

from torchlight.geometry.analytic_shadow import Block
from torchlight.light.environment import EnvironmentMap

from .photograph import renderer

Shape = dict[str, Any]
FINE_ROWS = 512  # of the map that Mitsuba interpolates: small maps are sampled several times as fast


def matt(albedo: float) -> Shape:
    """Returns a grey Lambertian surface."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}


def satin(albedo: float, roughness: float = 0.3) -> Shape:
    """Returns a grey Lambertian surface under rough lacquer of refractive index 1.5 (GGX), as on polished wood."""
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": roughness,
        "int_ior": 1.5,
        "diffuse_reflectance": {"type": "rgb", "value": albedo},
    }


def plane(center: tuple[float, float], size: tuple[float, float], surface: Shape) -> Shape:
    """Returns a rectangle of z = 0 that faces up."""
    (x, y), (width, depth) = center, size
    place = renderer().ScalarTransform4f().translate([x, y, 0.0]).scale([width / 2, depth / 2, 1.0])
    return {"type": "rectangle", "to_world": place, "bsdf": surface}


def standing(block: Block, surface: Shape) -> Shape:
    """Returns a block on z = 0."""
    width, depth, height = block.size
    place = (
        renderer()
        .ScalarTransform4f()
        .translate([*block.translation, height / 2])
        .rotate([0.0, 0.0, 1.0], block.rotation_degrees)
        .scale([width / 2, depth / 2, height / 2])
    )
    return {"type": "cube", "to_world": place, "bsdf": surface}


def distant(environment: EnvironmentMap) -> Shape:
    """Returns the upper half of a map as distant light, constant over each of its pixels; below the plane it is dark.

    Only one per scene: Mitsuba takes a single environment.
    """
    mitsuba = renderer()
    turn = mitsuba.ScalarTransform4f().rotate([1.0, 0.0, 0.0], 90.0)
    return {"type": "envmap", "bitmap": mitsuba.Bitmap(constant_per_pixel(environment, FINE_ROWS)), "to_world": turn}
