"""Angles between directions."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor


def widest_degrees(directions: Float[Tensor, "directions 3"]) -> float:
    """Returns the largest angle between any two unit vectors, by their chord: exact for small angles, too."""
    chord = torch.linalg.vector_norm(directions[:, None] - directions[None], dim=-1).max()
    return math.degrees(2 * math.asin(min(float(chord) / 2, 1.0)))
