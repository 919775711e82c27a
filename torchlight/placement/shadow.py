"""Where the object really stands: its place on the plane and its turn, refined by what its shadow leaves unexplained.

    q = (x, y, turn about the vertical through the object's middle),    r(q) = W^(1/2) (A(q) c(q) - b)

c(q) is the light of the adaptive method with the object at q, so that only q is left to vary: variable projection
(Golub and Pereyra, SIAM Journal on Numerical Analysis 10, 1973). With A the columns of the squares that shine and P
the projection on their span, and without the term that is proportional to the residual (Kaufman, BIT 15, 1975),

    J = (1 - P) W^(1/2) (dA/dq) c,      Gauss-Newton step  -(J'J + damping)^-1 J'r.

What light on these squares can do as well as a movement is projected away: J is what a movement alone can explain. A
light that turns moves the shadow of a top and leaves that of the foot; the foot tells them apart.

All occluders move as one. Everything is done on the mean of the channels.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.placement.report import Placement
from torchlight.shadow_fit import (
    Fit,
    Frame,
    Look,
    Normal,
    Pose,
    at,
    block_sums,
    cast,
    followed,
    frame_of,
    linearized,
    seen_again,
    significance,
    solved,
)

MAX_STEPS = 6
DAMPINGS = (0.0, 1.0, 10.0)  # of the mean eigenvalue of J'J, tried in turn until a step explains more
SUFFICIENT = 0.25  # of what a step promises: less may be the luck of another choice of squares
STILL = 0.1  # of a footprint: a smaller step, if it is also within its deviation, is not worth another light
DOUBT = 4.0  # deviations that a movement must exceed to be believed; normal noise alone does once in 900 photographs


def refine(scene: Scene, look: Look, settings: AdaptiveHaar | None = None) -> tuple[Scene, Placement]:
    """Returns the scene with its occluders where their shadow says they are, and how far that is from where they were.

    At most `MAX_STEPS` steps, each no further than one sample and only to where the same samples are explained better.
    The scene is left as it was where the movement does not exceed `DOUBT` of its deviations, or where the sum of
    squared residuals does not fall by more than DOUBT^2 independent errors contribute (`explained`). A direction that
    is known to no better than a sample is not moved along: the turn of a round object, for example.

    Args:
        scene: as stated.
        look: what the photograph shows of the receiver's samples when the object is as in a scene: which of them are
            hidden depends on that.
        settings: how light is found.
    """
    settings = AdaptiveHaar() if settings is None else settings
    frame = frame_of(scene)
    first = fit = solved(frame, torch.zeros(3, dtype=torch.float64), look, settings)
    normal = linearized(frame, fit)
    steps, found = 0, better(frame, fit, normal, settings)
    while found is not None:
        fit = seen_again(frame, found, look, settings)
        normal, steps = linearized(frame, fit), steps + 1
        found = better(frame, fit, normal, settings) if steps < MAX_STEPS else None
    return decided(frame, first, fit, normal, steps)


def better(frame: Frame, fit: Fit, normal: Normal, settings: AdaptiveHaar) -> Fit | None:
    """Returns the fit after a step that explains the same samples better; None where there is none worth its light."""
    if at_rest(normal):
        return None
    for damping in DAMPINGS:
        change = step(normal, damping)
        pose = fit.pose + change
        trial = followed(fit, pose, cast(at(frame, pose), settings), fit.observation, settings)
        if fit.cost - trial.cost > SUFFICIENT * promised(normal, change):
            return trial
    return None


def at_rest(normal: Normal) -> bool:
    """Returns whether the next step would be small and within its own deviation."""
    ahead = step(normal, 0.0)
    return float(reach(ahead)) < STILL and significance(ahead, normal) < 1


def step(normal: Normal, damping: float) -> Pose:
    """Returns the damped step along the directions that are determined, no point of the object beyond a footprint."""
    values = normal.values + damping * normal.values.mean()
    along = torch.where(normal.determined, -(normal.vectors.T @ normal.gradient) / values, 0.0)
    change = normal.vectors @ along
    return change / reach(change).clamp(min=1)


def promised(normal: Normal, change: Pose) -> float:
    """Returns by how much |r|^2 falls with a step if r is linear in it."""
    along = normal.vectors.T @ change
    return -float(2 * normal.gradient @ change + normal.values @ along.square())


def reach(change: Pose) -> Float[Tensor, ""]:
    """Returns how far a point of the object moves at most, in footprints."""
    return torch.hypot(change[0], change[1]) + change[2].abs()


def decided(frame: Frame, first: Fit, last: Fit, normal: Normal, steps: int) -> tuple[Scene, Placement]:
    """Returns the scene and the report: as found where it is believed, else as stated."""
    deviation = normal.covariance.diagonal().sqrt()
    sizes = (frame.unit * deviation * torch.tensor([1.0, 1.0, math.degrees(1.0)], dtype=torch.float64)).tolist()
    known = [size if spread < 1 else None for size, spread in zip(sizes, deviation.tolist(), strict=True)]
    believed = explained(frame, first, last) > DOUBT**2 and significance(last.pose, normal) > DOUBT
    kept = last if believed else first
    x, y, turn = (kept.pose * frame.unit).tolist()
    placement = Placement(
        by="shadow",
        moved=(x, y),
        turned_degrees=math.degrees(turn),
        deviation=(known[0], known[1], known[2]),
        rms_before=first.rms_255,
        rms_after=kept.rms_255,
        steps=steps,
        verdict=verdict(believed, normal, steps),
    )
    return at(frame, kept.pose) if believed else frame.scene, placement


def explained(frame: Frame, first: Fit, last: Fit) -> float:
    """Returns by how much the sum of squared residuals fell, in units of what one independent error contributes.

    Errors of neighbours may be alike: as many samples count as one as the sums of residuals over squares of samples are
    larger than those of independent ones.
    """
    used = int((last.observation.weights > 0).sum())
    sums = block_sums(last.residual[:, None], frame.scene.receiver)
    alike = max(1.0, float(sums.square().sum() / last.residual.square().sum().clamp(min=1e-300)))
    return used / alike * ((first.rms_255 / max(last.rms_255, 1e-300)) ** 2 - 1)


def verdict(believed: bool, normal: Normal, steps: int) -> str:
    """Returns what was decided and why."""
    if not bool(normal.determined.any()):
        return "left as stated: the shadow does not tell its place to within a sample"
    if not believed:
        return f"left as stated: no movement beyond {DOUBT:.0f} of its deviations explains the shadow better"
    if steps == MAX_STEPS and not at_rest(normal):
        return f"moved, and was not at rest after {MAX_STEPS} steps (check the scene file),"
    return "moved"
