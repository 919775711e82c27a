"""From light to shadows: the receiver's values under known light, by coefficients or from an environment map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, SceneError, ShapeError
from torchlight.geometry.receiver import Receiver, receiver_points
from torchlight.geometry.scene import Scene, shadowing
from torchlight.geometry.visibility import OcclusionTest, scene_occlusion
from torchlight.light.cubature import cubature
from torchlight.light.environment import EnvironmentMap
from torchlight.light.overlap import latlong_to_texels
from torchlight.precision import check_precision
from torchlight.threads import ordered_map
from torchlight.transfer import Transfer

RAYS = 131_072  # directions per map; halving the error of a soft sky costs 2.5 times as many
MAX_RAYS = 2**24
RAYS_PER_BLOCK = 1_000_000
Progress = Callable[[int, int], None]


def irradiance(
    matrix: Float[Tensor, "points coeffs"], coefficients: Float[Tensor, "*batch coeffs"]
) -> Float[Tensor, "*batch points"]:
    """Returns E = T c, the irradiance of every sample under light with coefficients c; torch differentiates it."""
    check_precision("matrix", matrix)
    check_precision("coefficients", coefficients)
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

    Torch differentiates it by the radiance, to any order, with the cells held as they are: exactly the derivative of
    the sum that is returned. Where the map is dark that sum knows many pixels by one ray; `relight_by` is as fine
    everywhere. The way back casts the rays once more and holds no more than the way there.

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
    check_precision("radiance", environment.radiance)
    scene = shadowing(lit_by(scene, environment))
    lead = environment.radiance.shape[:-3]
    maps = environment.radiance.cpu().reshape(-1, *environment.radiance.shape[-3:])
    images = [
        _irradiance_of_map(scene, EnvironmentMap(radiance, environment.nonnegative), rays, progress)
        for radiance in maps
    ]
    values = torch.stack(images).reshape(*lead, 3, -1).to(environment.radiance)
    return values * albedo_over_pi(scene.receiver, values)


def relight_by(transfer: Transfer, scene: Scene, environment: EnvironmentMap) -> Float[Tensor, "*batch 3 points"]:
    """Returns what the receiver shows under many maps by one transport: v = albedo T A L / pi, A averages over texels.

    One linear operator for all maps: thousands a second, differentiated by torch as two products. The light is as fine
    as the transport's texels and no finer; `relight` is for what must be right to a fraction of 255.

    Args:
        transfer: of the scene, from `precompute`; its device and dtype are those of the work.
        scene: receiver and albedo.
        environment: one or several maps.

    Raises:
        ShapeError: half precision, or a transport of another receiver.
        SceneError: the light stands elsewhere than where the transport, made for the scene, takes it.
    """
    check_precision("radiance", environment.radiance)
    if transfer.transport.shape[0] != scene.receiver.points:
        raise ShapeError(
            f"transport: {transfer.transport.shape[0]} samples, but the scene's receiver has {scene.receiver.points}; "
            "precompute it for this scene"
        )
    if lit_by(scene, environment).light_plane != scene.light_plane:
        raise SceneError("this light stands near; state 'light' in the scene file and precompute the transport of that")
    texels = latlong_to_texels(environment.radiance.to(transfer.transport), transfer.resolution)
    values = transfer.mv(texels).to(environment.radiance)
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


# --- rays ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sight:
    """Rays from directions to samples: V, block by block and never held whole.

    Attributes:
        test: tells which are hidden.
        points: the samples, [points, 3].
        directions: one per ray.
        offsets: of the rays' ends within the footprints.
        progress: called with (rays done, rays) on the way there.
    """

    test: OcclusionTest
    points: np.ndarray
    directions: Float[Tensor, "rays 3"]
    offsets: Float[Tensor, "rays 2"]
    progress: Progress | None = None


def _irradiance_of_map(
    scene: Scene, environment: EnvironmentMap, rays: int, progress: Progress | None
) -> Float[Tensor, "3 points"]:
    cells = cubature(environment, count=rays)
    offsets = ray_offsets(len(cells.directions), scene.receiver)
    sight = Sight(scene_occlusion(scene), receiver_points(scene.receiver), cells.directions, offsets, progress)
    return _Shone.apply(cells.fluxes, sight)  # pyright: ignore[reportReturnType]


class _Shone(torch.autograd.Function):
    """E = V'F: what samples receive of the rays' fluxes. Linear, so that its derivative is its adjoint, and again."""

    @staticmethod
    def forward(fluxes: Tensor, sight: Sight) -> Tensor:
        flows = fluxes.detach().double()  # other threads would record
        total = torch.zeros(3, len(sight.points), dtype=torch.float64)
        for part, found in in_blocks(sight, lambda part, seen: flows[part].T @ seen):
            total += found
            if sight.progress is not None:
                sight.progress(part.stop, len(flows))
        return total

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Sight], output: Tensor) -> None:
        ctx.sight = inputs[1]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        return _Gathered.apply(gradients[0], ctx.sight), None


class _Gathered(torch.autograd.Function):
    """V E: what each ray finds of one value per channel and sample, the adjoint of `_Shone`."""

    @staticmethod
    def forward(values: Tensor, sight: Sight) -> Tensor:
        columns = values.detach().double().T
        return torch.cat([found for _, found in in_blocks(sight, lambda part, seen: seen @ columns)])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Sight], output: Tensor) -> None:
        ctx.sight = inputs[1]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        return _Shone.apply(gradients[0], ctx.sight), None


def in_blocks(sight: Sight, task: Callable[[slice, Tensor], Tensor]) -> Iterator[tuple[slice, Tensor]]:
    """Yields what a task makes of each block of rays and of the samples that they reach, [rays, points] of 0 and 1."""
    count, step = len(sight.directions), max(1, RAYS_PER_BLOCK // len(sight.points))

    def work(start: int) -> tuple[slice, Tensor]:
        part = slice(start, min(start + step, count))
        directions, offsets = sight.directions[part].numpy(), sight.offsets[part].numpy()
        hidden = sight.test.hidden_on_plane(sight.points, directions, offsets)
        return part, task(part, 1.0 - torch.from_numpy(hidden).double())

    yield from ordered_map(work, range(0, count, step))


def ray_offsets(count: int, receiver: Receiver) -> Float[Tensor, "rays 2"]:
    """Returns a shift of the ray origins within the footprint for every ray: a rank-1 lattice, in the scene's unit."""
    index = torch.arange(count, dtype=torch.float64)[:, None]
    lattice = (index * torch.tensor([0.7548776662466927, 0.5698402909980532], dtype=torch.float64) + 0.5) % 1.0
    return (lattice - 0.5) * torch.tensor(receiver.footprint, dtype=torch.float64)
