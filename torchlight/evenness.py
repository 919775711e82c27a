"""A recovered light made fit for surfaces that face any way: even where its photograph does not tell (`evenness`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.analysis.confidence import pixel_texels
from torchlight.analysis.evenness import Facts, even_light, scales_of
from torchlight.errors import SceneError
from torchlight.facings import Facings, facings_of, telling
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
HALVINGS = 40  # of the range in which a texel's level lies
MOST_PASSES = 5  # where the photograph is not explained by then
WORSE = 2.0  # times the residual: then the light is left as it was found


@torch.no_grad()
def evened(
    photo: LinearPhoto | Float[Tensor, "3 height width"],
    scene: Scene,
    light: EnvironmentMap,
    transfer: Transfer | None = None,
    progress: Progress | None = None,
    bounce: bool = False,
) -> EnvironmentMap:
    """Returns a light that explains the photograph, and is even where the photograph does not tell.

    Where that leaves twice as much of it unexplained after five passes, or rounding leaves no answer, the light is
    returned as found.

    What is changed is the mean over texels of 6 degrees (`analysis.evenness` says how), by even light that is added to
    a texel or taken away. So a sun that the shadows show keeps its shape and what it has over its surroundings. Where
    the scene says that its objects are matt, what the photograph shows of them tells as well (`facings`).

    Args:
        photo: that the light was recovered from, linear; rectified where the scene has no camera.
        scene: of the photograph.
        light: recovered from it, from far away and nowhere negative.
        transfer: of the scene, a power of two of texels along an edge; 16 when absent, 6 degrees.
        progress: called with channels done and their number, of all passes.
        bounce: whether matt objects are lit by the plane too.

    Raises:
        SceneError: the light stands near, or is negative somewhere.
    """
    if light.plane is not None or not light.nonnegative:
        what = "stands near" if light.plane is not None else "is negative somewhere"
        raise SceneError(f"evened: this light {what}; use it as it is")
    linear = photo if isinstance(photo, LinearPhoto) else linear_photo(photo)
    found, light = light, finer(light)
    transfer = precompute(scene, RESOLUTION) if transfer is None else transfer
    facings = facings_of(linear, scene, light, bounce) if scene.occluder_matt else None
    count = 0

    def counted(means: Float[Tensor, " texels"]) -> Float[Tensor, " texels"]:
        nonlocal count
        count += 1
        if progress is not None:
            progress(count, max(PASSES, -(-count // len(light.radiance))) * len(light.radiance))
        return means

    enough, even = WORSE * unexplained(linear, scene, light), light
    try:
        for done in range(1, MOST_PASSES + 1):
            facts = told(linear, scene, even, transfer, light)
            facts = facts if facings is None else told_too(facts, facings, even, transfer.resolution)
            even = evener(even, facts, counted)
            if done >= PASSES and unexplained(linear, scene, even) <= enough:
                return even
    except torch.linalg.LinAlgError:
        pass
    return found


def evener(
    light: EnvironmentMap, facts: list[Facts], counted: Callable[[Float[Tensor, " texels"]], Float[Tensor, " texels"]]
) -> EnvironmentMap:
    """Returns the light with the means that its facts allow; what is made of each channel passes through `counted`."""
    resolution = round((len(facts[0].start) / 3) ** 0.5)
    scales = scales_of(resolution)
    after = [counted(means) for means in single_threaded_map(lambda channel: even_light(channel, scales), facts)]
    before = texel_means(light.radiance, resolution)
    return replace(light, radiance=with_means(light.radiance, before, torch.stack(after)))


def told_too(facts: list[Facts], facings: Facings, light: EnvironmentMap, resolution: int) -> list[Facts]:
    """Returns what the plane tells and what the objects tell, both round the same light."""
    more = telling(facings, light, resolution)
    return [
        replace(channel, gram=channel.gram + gram, slopes=channel.slopes + slopes)
        for channel, (gram, slopes) in zip(facts, more, strict=True)
    ]


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
    is off tells less. A texel's column is that of even light within it: where less than even light can be taken away
    the shadow changes otherwise, which the next pass, round the light as it has become, sees in what is left.

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
    """Returns the map whose texels' means were `before` with the means `after`.

    Where a mean rises, even light is added; where it falls, even light is taken away, but of no pixel more than it has:

        sum over pixels of a texel of areas max(0, L - level) = after areas,    the level by bisection.

    So detail, which the photograph told by its shadows, keeps its contrast for as long as there is light under it.
    """
    resolution = round((before.shape[-1] / 3) ** 0.5)
    index = pixel_texels(resolution, radiance.shape[-2])
    inside = index >= 0
    pixels, place = radiance[:, : index.shape[0]].double()[:, inside], index[inside]
    areas = latlong.row_solid_angles(radiance.shape[-2])[: index.shape[0]].double()[:, None].expand(index.shape)[inside]
    least = torch.zeros_like(before)
    most = least.scatter_reduce(1, place.expand_as(pixels), pixels, "amax")
    wanted = after * before.new_zeros(before.shape[-1]).index_add_(0, place, areas)
    for _ in range(HALVINGS):
        level = (least + most) / 2
        left = torch.zeros_like(before).index_add_(1, place, (pixels - level[:, place]).clamp(min=0) * areas)
        least, most = torch.where(left > wanted, level, least), torch.where(left > wanted, most, level)
    taken = torch.where(after < before, (least + most) / 2, 0.0)
    changed = (pixels - taken[:, place]).clamp(min=0) + (after - before).clamp(min=0)[:, place]
    result = radiance.clone()
    result[:, : index.shape[0]][:, inside] = changed.to(radiance)
    return result
