"""From light to shadows: the receiver's values under known light, by coefficients or from an environment map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, SceneError, ShapeError
from torchlight.geometry.receiver import Receiver, receiver_points
from torchlight.geometry.scene import Scene, shadowing
from torchlight.geometry.visibility import scene_occlusion
from torchlight.light.cubature import cubature
from torchlight.light.environment import EnvironmentMap
from torchlight.threads import ordered_map

RAYS = 131_072  # directions per map; halving the error of a soft sky costs 2.5 times as many
MAX_RAYS = 2**24
RAYS_PER_BLOCK = 1_000_000
Progress = Callable[[int, int], None]


def irradiance(
    matrix: Float[Tensor, "points coeffs"], coefficients: Float[Tensor, "*batch coeffs"]
) -> Float[Tensor, "*batch points"]:
    """Returns E = T c, the irradiance of every sample under light with coefficients c; torch differentiates it."""
    return coefficients @ matrix.T


def albedo_over_pi(receiver: Receiver, like: Tensor) -> Float[Tensor, "3 1"]:
    """Returns the factor from irradiance to photograph values per channel: v = albedo E / pi."""
    albedo = receiver.albedo if receiver.albedo is not None else (1.0, 1.0, 1.0)
    return torch.tensor(albedo, dtype=like.dtype, device=like.device)[:, None] / torch.pi


def relight(
    scene: Scene, environment: EnvironmentMap, rays: int = RAYS, progress: Progress | None = None
) -> Float[Tensor, "*batch 3 points"]:
    """Returns what the receiver shows under an environment map: v = albedo E / pi.

    The map is integrated at its own resolution: its upper half is cut into about `rays` cells of similar flux, bright
    pixels finer than a pixel and dark ones together, and every cell sends one ray to a point of each footprint.

    Args:
        scene: occluders, receiver and albedo.
        environment: one or several maps.
        rays: cells per map.
        progress: called with (rays done, rays).

    Raises:
        ConfigError: a number of rays below 1 or above `MAX_RAYS`.
        ShapeError: radiance of half precision.
        SceneError: the scene says that light stands elsewhere than this light does.
    """
    if not 1 <= rays <= MAX_RAYS:
        raise ConfigError(f"rays: expected 1 to {MAX_RAYS:,}, got {rays:,}; {RAYS:,} is usual")
    kind = environment.radiance.dtype
    if kind not in (torch.float32, torch.float64):
        raise ShapeError(f"radiance: expected float32 or float64, got {kind}; convert it with .float()")
    scene = shadowing(lit_by(scene, environment))
    lead = environment.radiance.shape[:-3]
    maps = environment.radiance.cpu().reshape(-1, *environment.radiance.shape[-3:])
    images = [
        _irradiance_of_map(scene, EnvironmentMap(radiance, environment.nonnegative), rays, progress)
        for radiance in maps
    ]
    values = torch.stack(images).reshape(*lead, 3, -1).to(environment.radiance)
    return values * albedo_over_pi(scene.receiver, values)


def lit_by(scene: Scene, environment: EnvironmentMap) -> Scene:
    """Returns the scene with its light where the environment's light stands.

    Raises:
        SceneError: the scene states another place.
    """
    if scene.light_plane is not None and scene.light_plane != environment.plane:
        there = "far away" if environment.plane is None else str(environment.plane)
        raise SceneError(
            f"the scene says that its light stands {scene.light_plane}, this light stands {there}; use the light.exr "
            "of an estimate of this scene, or leave 'light' out of the scene file"
        )
    return replace(scene, light_plane=environment.plane)


def _irradiance_of_map(
    scene: Scene, environment: EnvironmentMap, rays: int, progress: Progress | None
) -> Float[Tensor, "3 points"]:
    cells = cubature(environment, count=rays)
    points = receiver_points(scene.receiver)
    test = scene_occlusion(scene)
    offsets = ray_offsets(len(cells.directions), scene.receiver)
    step = max(1, RAYS_PER_BLOCK // len(points))

    def lit(start: int) -> Float[Tensor, "3 points"]:
        part = slice(start, start + step)
        hidden = test.hidden_on_plane(points, cells.directions[part].numpy(), offsets[part].numpy())
        return cells.fluxes[part].double().T @ (1.0 - torch.from_numpy(hidden).double())

    total = torch.zeros(3, len(points), dtype=torch.float64)
    starts = range(0, len(cells.directions), step)
    for done, part in enumerate(ordered_map(lit, starts), start=1):
        total += part
        if progress is not None:
            progress(min(done * step, len(cells.directions)), len(cells.directions))
    return total


def ray_offsets(count: int, receiver: Receiver) -> Float[Tensor, "rays 2"]:
    """Returns a shift of the ray origins within the footprint for every ray: a rank-1 lattice, in the scene's unit."""
    index = torch.arange(count, dtype=torch.float64)[:, None]
    lattice = (index * torch.tensor([0.7548776662466927, 0.5698402909980532], dtype=torch.float64) + 0.5) % 1.0
    return (lattice - 0.5) * torch.tensor(receiver.footprint, dtype=torch.float64)
