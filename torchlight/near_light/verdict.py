"""Is the light near? A test of one photograph, with a stated rate of false alarms.

Let R(k) be the sum of squared residuals of the best light at the height 1 / k (`near_light.model`) and n the number of
samples. Errors of neighbouring samples are alike, those of the model above all, so that `BLOCK` x `BLOCK` samples
count as one. Distant light has k = 0, and

    F = (R(0) - R(k)) / (R(k) / (n / BLOCK^2))

is then the square of a normal variable; s = k / sqrt(F) is the deviation of k. An object that is measured wrong looks
like a near lamp as well: `TOLERANCE` of its height is added. The test is one-sided, for light from beyond infinity
does not exist:

    z = k / sqrt(s^2 + (TOLERANCE / top)^2),     p = P(normal > z),     near where p < `FALSE_ALARMS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.geometry.receiver import receiver_corners
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.light.peaks import flux_peaks
from torchlight.near_light.angles import widest_degrees
from torchlight.near_light.fits import Fit, Heights
from torchlight.near_light.model import Shadow, coarse_squares, shadow_of
from torchlight.photo.observation import Observation
from torchlight.threads import single_threaded

FALSE_ALARMS = 0.01
TOLERANCE = 0.01  # of the object's height: 0.4 mm of 40
BLOCK = 4  # samples along the edge of a square of like errors
MIN_SAMPLES = 100
UNEXPLAINED = 0.5  # of what varies over the plane, by the best light
REFINED_AT = (0.0, 0.08)  # k times the object's height
SCANNED = (0.0, 0.03, 0.08, 0.16, 0.3, 0.5)
LEAST_SCANNED = 3
POLISHED = 3  # steps between scanned values
CLOSE = 0.03  # of k: closer steps are not worth a fit


@dataclass(frozen=True)
class NearLight:
    """What one photograph tells of the distance of its light.

    Attributes:
        flagged: whether the light is near: p_value < `FALSE_ALARMS`.
        p_value: chance that distant light looks as near as this.
        drift_degrees: how much the direction of the light turns over the receiver: the largest angle between the
            directions from two of its corners to the lamp; 0 where the best light is distant.
        deviation_degrees: of the drift, its standard deviation.
        distance: from the object's foot to the lamp, in the scene's unit; inf where the best light is distant.
        height: of the lamp above the plane, likewise.
    """

    flagged: bool
    p_value: float
    drift_degrees: float
    deviation_degrees: float
    distance: float
    height: float


@dataclass(frozen=True, eq=False)
class Profile:
    """The best light over all heights.

    Attributes:
        curvature: k.
        squares: of its light.
        fit: with that light.
        compared: another curvature: 0, or where the best is 0 a little more.
        compared_error: the sum of squared residuals there.
    """

    curvature: float
    squares: Int[Tensor, "squares 4"]
    fit: Fit
    compared: float
    compared_error: float


def near_light(scene: Scene, observation: Observation) -> NearLight | None:
    """Returns whether the light of one photograph is near; None where that cannot be told.

    Too few samples are usable or lit, or no light of any height explains half of what varies over the plane: then there
    is no shadow to judge by, or the scene is not that of the photograph.

    Args:
        scene: occluders and receiver.
        observation: [channels, points] and [points], of one photograph, the scene's reference divided out.
    """
    lit = observation.samples.mean(dim=-2) > 0
    usable = observation.weights > 0
    if int((lit & usable).sum()) < MIN_SAMPLES or len(scene.triangles) == 0:
        return None
    with single_threaded():  # many small solves: two threads would take twice the time of one
        return judged(shadow_of(scene, observation.samples, observation.weights))


def judged(shadow: Shadow) -> NearLight | None:
    """Returns whether the light of a shadow is near; None where that cannot be told."""
    if not shadow.top > 0:
        return None
    best = profile(shadow)
    if not best.fit.error < UNEXPLAINED * variation(shadow):
        return None
    spread = math.hypot(deviation(len(shadow.values), best), TOLERANCE / shadow.top)
    p_value = 0.5 * math.erfc(best.curvature / spread / math.sqrt(2))
    direction = peak(best)
    drift, further = (drift_degrees(shadow, direction, k) for k in (best.curvature, best.curvature + spread))
    height = 1 / best.curvature if best.curvature > 0 else math.inf
    distance = height / float(direction[2])
    return NearLight(p_value < FALSE_ALARMS, p_value, drift, further - drift, distance, height)


def variation(shadow: Shadow) -> float:
    """Returns the weighted sum of squared differences from the mean."""
    weights = shadow.root.square()
    mean = (weights * shadow.values).sum() / weights.sum()
    return float((weights * (shadow.values - mean).square()).sum())


def profile(shadow: Shadow) -> Profile:
    """Returns the curvature whose best light leaves the least residual.

    The squares of light are made fine where the light of any of several heights needs it, so that no height is
    favoured, and once more at the best one.
    """
    heights = Heights(shadow, {})
    squares, shown = coarse_squares(), torch.ones_like(shadow.values)
    for scaled in REFINED_AT:
        squares, found = heights.refined(squares, scaled / shadow.top, shown)
        shown = found.shown
    best, compared = search(heights, squares, shown, SCANNED), SCANNED[1]
    if best > 0:
        squares, found = heights.refined(squares, best / shadow.top, shown)
        shown, compared = found.shown, 0.0
        best = search(heights, squares, shown, (0.85 * best, best, 1.15 * best))
    near, other = (heights.best(squares, k / shadow.top, shown) for k in (best, compared))
    return Profile(best / shadow.top, squares, near, compared / shadow.top, other.error)


def search(
    heights: Heights, squares: Int[Tensor, "squares 4"], shown: Float[Tensor, " used"], scanned: tuple[float, ...]
) -> float:
    """Returns k times the object's height of least residual, looked for upwards until it rises, then by parabolas."""

    def error(scaled: float) -> float:
        return heights.best(squares, scaled / heights.shadow.top, shown).error

    known: dict[float, float] = {}
    for scaled in scanned:
        known[scaled] = error(scaled)
        if len(known) >= LEAST_SCANNED and known[scaled] > min(known.values()):
            break
    for _ in range(POLISHED):
        order = sorted(known)
        place = min(range(len(order)), key=lambda index: known[order[index]])
        if place in (0, len(order) - 1):
            break
        around = order[place - 1 : place + 2]
        step = lowest(around, [known[scaled] for scaled in around])
        if abs(step - order[place]) < CLOSE * order[place]:
            break
        known[step] = error(step)
    return min(known, key=lambda scaled: known[scaled])


def lowest(places: list[float], values: list[float]) -> float:
    """Returns where the parabola through three points, the middle one lowest, is lowest."""
    left, right = places[1] - places[0], places[2] - places[1]
    falling, rising = (values[0] - values[1]) / left, (values[2] - values[1]) / right
    if falling + rising <= 0:
        return places[1]
    return places[1] + (falling * right - rising * left) / (falling + rising) / 2


def deviation(samples: int, best: Profile) -> float:
    """Returns the standard deviation of the curvature, by how fast the residual grows away from the best."""
    unit = best.fit.error / (samples / BLOCK**2)
    rise = (best.compared_error - best.fit.error) / max(unit, 1e-300)
    return abs(best.curvature - best.compared) / math.sqrt(rise) if rise > 0 else math.inf


def peak(best: Profile) -> Float[Tensor, "3"]:
    """Returns the direction of the strongest source seen from the object's foot."""
    directions = cubemap.cell_directions(cubemap.square_cells(best.squares))
    return flux_peaks(directions, best.fit.flux, count=1).directions[0]


def drift_degrees(shadow: Shadow, direction: Float[Tensor, "3"], curvature: float) -> float:
    """Returns the largest angle between the directions from two corners of the receiver to the lamp."""
    foot = torch.cat([shadow.centre, torch.zeros(1, dtype=torch.float64)])
    offsets = curvature * (receiver_corners(shadow.scene.receiver) - foot)
    towards = torch.nn.functional.normalize(direction / direction[2] - offsets, dim=-1)
    return widest_degrees(towards)
