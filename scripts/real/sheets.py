"""What the sheets of the cube, the pencil and the chair show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.receiver import sample_centers
from torchlight.io.images import read_photo
from torchlight.light.environment import EnvironmentMap, radiance_at
from torchlight.observing import linearize
from torchlight.preview import to_srgb8

from .chair import SCREEN, Chair
from .cube import FOLDER, HalfShadow, predicted_shadow
from .drawing import read_drawing
from .pencil import Pencil
from .pictures import ORANGE, PINK, SKY, Line, Mark, Sheet

SCREEN_X, SCREEN_Z = (27.375, 429.0), (138.711, 444.5)  # mm, as measured
SCREEN_BLOCKS = (29, 36)
PIXELS_PER_BLOCK = 8
PERCENTILE = 0.99


def cube_sheet(half: HalfShadow, photo: Path, title: str) -> Sheet:
    """Returns the cube's sheet: left of the axis what was fitted, right of it what was photographed, at one exposure.

    Args:
        half: what was found.
        photo: the photograph's file.
        title: of the sheet.
    """
    used = half.shown.weights > 0
    predicted, seen = half.estimate.predicted, half.shown.samples
    exposure = predicted[:, half.right].amax(dim=-1) / seen[:, half.right].quantile(PERCENTILE, dim=-1)
    observed = torch.where(half.right, seen * exposure[:, None], half.estimate.observation.samples)
    drawing = read_drawing(FOLDER / "drawn" / "img4.yaml")
    lines = [
        Line("axis", torch.stack([drawing.start, drawing.end]), SKY),
        Line("shadow's right part, drawn by hand", torch.cat([drawing.shadow, drawing.shadow[:1]]), ORANGE),
    ]
    lines += outline(predicted_shadow(half), half)
    peak = Mark("strongest source", half.estimate.peaks.directions[0], PINK)
    picture = linearize(read_photo(photo), half.scene).radiance
    compared = used & ~half.right
    return Sheet(title, picture, half.scene, observed, predicted, used, compared, half.estimate.light, [peak], lines)


def outline(shadow: Bool[Tensor, " points"], half: HalfShadow) -> list[Line]:
    """Returns the rim of the predicted shadow, as the outline of its rows."""
    columns, rows = half.scene.receiver.samples
    centers = sample_centers(half.scene.receiver).reshape(rows, columns, 2)
    marked = shadow.reshape(rows, columns)
    step = half.scene.receiver.size[0] / columns / 2
    inhabited = [row for row in range(rows) if bool(marked[row].any())]
    first = [centers[row, marked[row]][0] - torch.tensor([step, 0.0]) for row in inhabited]
    last = [centers[row, marked[row]][-1] + torch.tensor([step, 0.0]) for row in inhabited]
    return [Line("predicted", torch.stack([*first, *reversed(last), first[0]]), PINK)] if inhabited else []


def pencil_sheet(found: Pencil) -> Sheet:
    """Returns the sheet of one photograph of the pencil."""
    observation = found.found.observation
    used = observation.weights > 0
    marks = [Mark("from the shadow's tip to the pencil's top", found.truth, SKY), Mark("peak", found.peak, PINK)]
    return Sheet(
        f"desk_pencil, {found.name}: peak off by {found.off_degrees:.2f} degrees",
        linearize(read_photo(found.photo), found.scene).radiance, found.scene, observation.samples,
        found.found.predicted, used, used, found.found.light, marks,
    )  # fmt: skip


def chair_sheet(found: Chair, title: str) -> Sheet:
    """Returns the chair's sheet."""
    used = found.shown.weights > 0
    return Sheet(
        title, found.radiance, found.scene, found.shown.samples, found.found.predicted, used, used, found.found.light
    )


def screen_pictures(found: Chair) -> list[tuple[str, np.ndarray]]:
    """Returns what the screen showed and what the wall's shadows say it showed."""
    return [
        ("on the screen", found.screen),
        ("from the shadows on the wall", to_srgb8(seen_screen(found.found.light))),
    ]


def seen_screen(light: EnvironmentMap) -> Float[Tensor, "3 rows columns"]:
    """Returns the light per area of the screen as its viewers see it: the first column at the largest x.

    Direction (x, y, H) of the light is place (x, y) of the plane z = H; an area dA there covers the solid angle
    cos^3 dA / H^2 and lights the wall by another cosine.
    """
    rows, columns = (PIXELS_PER_BLOCK * count for count in SCREEN_BLOCKS)
    x = torch.linspace(SCREEN_X[1], SCREEN_X[0], 2 * columns + 1, dtype=torch.float64)[1::2]
    y = torch.linspace(SCREEN_Z[1], SCREEN_Z[0], 2 * rows + 1, dtype=torch.float64)[1::2]
    places = torch.stack([x.expand(rows, -1), y[:, None].expand(-1, columns), torch.full((rows, columns), SCREEN)], -1)
    cosine = SCREEN / places.norm(dim=-1)
    picture = radiance_at(light, places).double() * cosine**4
    return picture / torch.quantile(picture.amax(dim=0).flatten(), PERCENTILE)
