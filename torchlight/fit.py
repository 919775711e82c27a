"""How well a light explains a photograph, as a picture: observed, predicted, and what is left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.drawing.content import UNUSED, FitContent, LeftOut
from torchlight.drawing.elsewhere import draw
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import luminance
from torchlight.photo.observation import Observation, Rejection
from torchlight.photo.radiometry import encode

REJECTED = {  # after Okabe and Ito: told apart with every common colour blindness
    Rejection.SATURATED: ("#D55E00", "saturated"),
    Rejection.SPECULAR: ("#F0E442", "glint"),
    Rejection.ROBUST: ("#56B4E9", "let go of by --robust"),
}
MIN_SCALE_255 = 1.0
NAMES = ("observed", "predicted")


def fit_picture(
    observation: Observation,
    predicted: Float[Tensor, "3 points"],
    receiver: Receiver,
    units: str,
    title: str,
    names: tuple[str, str] = NAMES,
) -> bytes:
    """Returns a PNG of `fit_content`, drawn here and now."""
    return draw(fit_content(observation, predicted, receiver, units, title, names))


def fit_content(
    observation: Observation,
    predicted: Float[Tensor, "3 points"],
    receiver: Receiver,
    units: str,
    title: str,
    names: tuple[str, str] = NAMES,
) -> FitContent:
    """Returns the observed and the predicted receiver and their difference.

    Observed and predicted are shown as sRGB with white at the brightest used sample; the difference is that of the
    luminance, predicted - observed, in 255ths of the same white. Samples that were not used are grey; those that the
    camera sees and that were left out have the colour of their `Rejection` in the first and the last picture.
    """
    used = observation.weights > 0
    white = observation.samples[:, used].max().item()
    difference = luminance(predicted - observation.samples) * (255.0 / white)
    first, second = (receiver_picture(values / white, used, receiver) for values in (observation.samples, predicted))
    return FitContent(
        (first, second),
        torch.where(used, difference, torch.nan).reshape(receiver.samples[::-1]).flip(0).numpy(force=True),
        max(MIN_SCALE_255, float(torch.quantile(difference[used].abs().double(), 0.998))),
        tuple(_left_out(observation, receiver)),
        names,
        title,
        units,
        extent_of(receiver),
    )


def _left_out(observation: Observation, receiver: Receiver) -> Iterator[LeftOut]:
    """Yields which samples were left out, how many and why."""
    columns, rows = receiver.samples
    grid = observation.rejections.reshape(rows, columns).flip(0).cpu().numpy()
    for why, (colour, name) in REJECTED.items():
        samples = grid == int(why)
        count = int(samples.sum())
        if count:
            yield LeftOut(samples, colour, f"{name}: {count} samples")


def receiver_picture(
    values: Float[Tensor, "3 points"], used: Bool[Tensor, " points"], receiver: Receiver
) -> Float[np.ndarray, "rows columns 3"]:
    """Returns samples as an sRGB picture, row 0 at the largest y, grey where not used."""
    columns, rows = receiver.samples
    encoded = encode(values.clamp(0, 1).reshape(3, rows, columns), "srgb").reshape(3, -1)
    shown = torch.where(used, encoded, torch.full_like(encoded, UNUSED)).reshape(3, rows, columns)
    return shown.flip(1).permute(1, 2, 0).numpy(force=True)


def extent_of(receiver: Receiver) -> tuple[float, float, float, float]:
    """Returns where a receiver's picture begins and ends: left, right, bottom, top."""
    (x, y), (width, height) = receiver.center, receiver.size
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2
