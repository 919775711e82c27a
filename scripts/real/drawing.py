"""What a person drew over a photograph: the shadow's axis, a part of its outline, and what is to be left out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from matplotlib.path import Path as Outline
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.io.yaml_file import read_yaml


@dataclass(frozen=True, eq=False)
class Drawing:
    """Lines on the receiver's plane, in the scene's unit.

    Attributes:
        start: a point of the shadow's axis.
        end: another, farther from the object.
        shadow: outline of the shadow right of the axis, seen along it with z up.
        foreign: outlines of what the scene does not know.
    """

    start: Float[Tensor, "2"]
    end: Float[Tensor, "2"]
    shadow: Float[Tensor, "corners 2"]
    foreign: tuple[Float[Tensor, "_ 2"], ...]


def read_drawing(path: Path) -> Drawing:
    """Returns the drawing that a file holds as numbers; ConfigError where one is missing."""
    document: Any = read_yaml(path)[0]
    try:
        axis = document["axis"]
        parts = [axis["from"], axis["through"], document["shadow_right"], *document["stick"]]
        start, end, shadow, *foreign = [torch.tensor(part, dtype=torch.float64) for part in parts]
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: expected axis (from, through), shadow_right and stick as numbers") from error
    return Drawing(start, end, shadow, tuple(foreign))


def inside(outline: Float[Tensor, "corners 2"], positions: Float[Tensor, "points 2"]) -> Bool[Tensor, " points"]:
    """Returns which positions lie within a closed polygon."""
    return torch.from_numpy(np.asarray(Outline(outline.numpy()).contains_points(positions.numpy())))


def right_of_axis(drawing: Drawing, positions: Float[Tensor, "points 2"]) -> Bool[Tensor, " points"]:
    """Returns which positions lie right of the axis for one who looks back along it, from its end at the object."""
    along = drawing.start - drawing.end
    away = positions.double() - drawing.end
    return along[0] * away[:, 1] - along[1] * away[:, 0] < 0


def foreign_part(drawing: Drawing, positions: Float[Tensor, "points 2"]) -> Bool[Tensor, " points"]:
    """Returns which positions lie within an outline of what the scene does not know."""
    marked = torch.zeros(len(positions), dtype=torch.bool)
    for outline in drawing.foreign:
        marked |= inside(outline, positions)
    return marked
