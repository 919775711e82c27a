"""A recovered light made fit for surfaces that face any way: even where its photograph does not tell (`evenness`)."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.analysis.confidence import pixel_texels
from torchlight.analysis.evenness import Facts, even_light, scales_of
from torchlight.errors import SceneError
from torchlight.geometry.scene import Scene
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.observing import observe
from torchlight.photo.noise import brightest_used, noise_share
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.precomputation import Progress, precompute
from torchlight.relighting import albedo_over_pi, relight
from torchlight.threads import single_threaded_map
from torchlight.transfer import Transfer

RESOLUTION = 16  # texels along a face's edge: 6 degrees
LEAST_ROWS = 128  # of the map: every texel holds centres of pixels
RAYS = 2**13
PASSES = 3  # round the light as it has become
WORSE = 2.0  # times the residual: then the light is left as it was found


@torch.no_grad()
def evened(
    photo: LinearPhoto | Float[Tensor, "3 height width"],
    scene: Scene,
    light: EnvironmentMap,
    transfer: Transfer | None = None,
    progress: Progress | None = None,
) -> EnvironmentMap:
    """Returns a light that explains the photograph, and is even where the photograph does not tell.

    Where that leaves twice as much of it unexplained, or rounding leaves no answer, the light is returned as found.

    What is changed is the mean over texels of 6 degrees (`analysis.evenness` says how): where that falls, all of a
    texel's pixels fall by the same factor, where it rises, even light is added. So a sun that the shadows show keeps
    its shape and its brightness.

    Args:
        photo: that the light was recovered from, linear; rectified where the scene has no camera.
        scene: of the photograph.
        light: recovered from it, from far away and nowhere negative.
        transfer: of the scene, a power of two of texels along an edge; 16 when absent, 6 degrees.
        progress: called with channels done and their number, of all passes.

    Raises:
        SceneError: the light stands near, or is negative somewhere.
    """
    if light.plane is not None or not light.nonnegative:
        what = "stands near" if light.plane is not None else "is negative somewhere"
        raise SceneError(f"evened: this light {what}; use it as it is")
    linear = photo if isinstance(photo, LinearPhoto) else linear_photo(photo)
    found, light = light, finer(light)
    transfer = precompute(scene, RESOLUTION) if transfer is None else transfer
    scales, even, count = scales_of(transfer.resolution), light, 0
    try:
        for _ in range(PASSES):
            after = []
            for means in single_threaded_map(
                lambda facts: even_light(facts, scales), told(linear, scene, even, transfer, light)
            ):
                after.append(means)
                count += 1
                if progress is not None:
                    progress(count, PASSES * len(light.radiance))
            before = texel_means(even.radiance, transfer.resolution)
            even = replace(even, radiance=with_means(even.radiance, before, torch.stack(after)))
    except torch.linalg.LinAlgError:
        return found
    worse = unexplained(linear, scene, even) > WORSE * unexplained(linear, scene, light)
    return found if worse else even


def unexplained(linear: LinearPhoto, scene: Scene, light: EnvironmentMap) -> float:
    """Returns the root mean square of what a light leaves of the photograph, over samples by weight and channels."""
    seen = observe(linear, scene)
    left = (seen.samples - relight(scene, light, RAYS)).double().square().mean(dim=0)
    weights = seen.weights.double()
    left = torch.where(weights > 0, left, 0.0)
    return float((left * weights).sum() / weights.sum().clamp(min=1e-300)) ** 0.5


def told(
    linear: LinearPhoto, scene: Scene, light: EnvironmentMap, transfer: Transfer, found: EnvironmentMap
) -> list[Facts]:
    """Returns what the photograph says of every channel, round a light.

    The noise is that measured, or what the light that was found leaves of the photograph if that is more: a model that
    is off tells less. A texel's column is that of even light within it: detail that is scaled with its texel casts
    another shadow, which the next pass, round the light as it has become, sees in what is left.

    Args:
        linear: the photograph.
        scene: of the photograph.
        light: that is made even.
        transfer: of the scene.
        found: the light as it was found.
    """
    observation = observe(linear, scene)
    factor = albedo_over_pi(scene.receiver, observation.samples).double()
    weights = observation.weights.double()
    received = replace(observation, samples=observation.samples.double() / factor)
    noise = float(noise_share(received, scene.receiver.samples) * brightest_used(received))

    def left_by(light: EnvironmentMap) -> Float[Tensor, "channels points"]:
        left = received.samples - relight(scene, light, RAYS).double() / factor
        return torch.where(weights > 0, left, 0.0)

    misfit = float((left_by(found).square().mean(dim=0) * weights).sum() / weights.sum().clamp(min=1e-300))
    variance = max(noise**2, misfit, 1e-60)
    columns = transfer.transport.double()
    gram = (columns.T * weights) @ columns / variance
    slopes = (left_by(light) * weights) @ columns / variance
    whole = columns.sum(dim=0)
    levels = (texel_means(found.radiance, transfer.resolution) @ whole / whole.sum().clamp(min=1e-300)).tolist()
    means = texel_means(light.radiance, transfer.resolution)
    return [Facts(gram, *parts) for parts in zip(slopes, means, levels, strict=True)]


def finer(light: EnvironmentMap) -> EnvironmentMap:
    """Returns the same map with pixels repeated until it has enough rows."""
    times = -(-LEAST_ROWS // light.height)
    radiance = light.radiance.detach().cpu()
    return replace(light, radiance=radiance.repeat_interleave(times, dim=-1).repeat_interleave(times, dim=-2))


def texel_means(radiance: Float[Tensor, "channels height width"], resolution: int) -> Float[Tensor, "channels texels"]:
    """Returns the mean over the pixels whose centres a visible texel holds, by solid angle, float64."""
    height = radiance.shape[-2]
    index = pixel_texels(resolution, height)
    rows = index.shape[0]
    inside = (index >= 0).flatten()
    areas = latlong.row_solid_angles(height)[:rows].double()[:, None].expand(index.shape).flatten()[inside]
    place = index.flatten()[inside]
    values = radiance[:, :rows].double().flatten(start_dim=1)[:, inside]
    count = 3 * resolution**2
    sums = values.new_zeros(values.shape[0], count).index_add_(1, place, values * areas)
    return sums / values.new_zeros(count).index_add_(0, place, areas).clamp(min=1e-300)


def with_means(
    radiance: Float[Tensor, "channels height width"],
    before: Float[Tensor, "channels texels"],
    after: Float[Tensor, "channels texels"],
) -> Float[Tensor, "channels height width"]:
    """Returns the map whose texels' means were `before` with the means `after`: scaled down, or raised evenly."""
    resolution = round((before.shape[-1] / 3) ** 0.5)
    index = pixel_texels(resolution, radiance.shape[-2])
    scale = torch.where(after < before, after / before.clamp(min=1e-300), 1.0)
    raised = (after - before).clamp(min=0)
    upper = radiance[:, : index.shape[0]].double()
    changed = upper * scale[:, index.clamp(min=0)] + raised[:, index.clamp(min=0)]
    result = radiance.clone()
    result[:, : index.shape[0]] = torch.where(index >= 0, changed, upper).to(radiance)
    return result
