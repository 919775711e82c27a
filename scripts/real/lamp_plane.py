"""How high a near lamp hangs, from the width of the shadow that it throws of an edge of known length and height."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import SceneError
from torchlight.photo.observation import Observation


def lamp_height(width: float, shadow: float, height: float) -> float:
    """Returns the height of a lamp above the plane: H = h s / (s - w).

    Args:
        width: w, of the object's upper edge, parallel to the plane.
        shadow: s, the length of its shadow.
        height: h, of the edge above the plane.

    Raises:
        SceneError: the shadow is no wider than the edge.
    """
    if not shadow > width:
        raise SceneError(f"a shadow {shadow:g} wide of an edge {width:g} wide is not that of a near lamp")
    return height * shadow / (shadow - width)


def shadow_width(
    observation: Observation, centers: Float[Tensor, "points 2"], rows: tuple[float, float], core: float, rim: float
) -> float:
    """Returns how wide a shadow is in x between its two places of half brightness.

    Brightness is the mean over channels and over all samples of a column between `rows`. Half lies midway between the
    mean of |x| < core, the umbra, and, on either side on its own, the mean of the lit plane beyond the rim. An evenly
    bright lamp is thereby measured from its middle.

    Args:
        observation: what the photograph shows.
        centers: x and y of the samples.
        rows: range in y.
        core: half the width of what is surely umbra.
        rim: |x| from which on the plane is lit; the next 10 units are used.

    Raises:
        SceneError: a side has no such place.
    """
    used = (observation.weights > 0) & (centers[:, 1] > rows[0]) & (centers[:, 1] < rows[1])
    places, column = centers[used, 0].unique(return_inverse=True)
    grey = observation.samples.mean(dim=-2)[used].double()
    profile = torch.zeros(len(places), dtype=torch.float64).index_add_(0, column, grey) / column.bincount()
    umbra = profile[places.abs() < core].mean()
    return sum(half_crossing(side * places, profile, umbra, core, rim) for side in (-1, 1))


def half_crossing(
    places: Float[Tensor, " columns"],
    profile: Float[Tensor, " columns"],
    umbra: Float[Tensor, ""],
    core: float,
    rim: float,
) -> float:
    """Returns the smallest place beyond the core at which the profile is midway between umbra and lit plane."""
    lit = profile[(places > rim) & (places < rim + 10)].mean()
    order = places.argsort()
    x, level = places[order], profile[order] - (umbra + lit) / 2
    crossing = ((x[:-1] > core) & (level[:-1] < 0) & (level[1:] >= 0)).nonzero()
    if not len(crossing):
        raise SceneError("the shadow's edge is not in sight on both sides")
    k = int(crossing[0])
    return (x[k] - level[k] * (x[k + 1] - x[k]) / (level[k + 1] - level[k])).item()
