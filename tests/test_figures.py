"""Pictures as PNG bytes: right way up, right exposure, and no file name that breaks them."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgba
from PIL import Image
from torch import Tensor
from torch.testing import assert_close

from torchlight import figures, fit
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import Observation, Rejection

RECEIVER = Receiver((1.0, -1.0), (4.0, 3.0), (4, 3))


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(png)))


def observation(value: float = 0.5) -> Observation:
    weights = torch.ones(12)
    weights[5] = 0
    return Observation(torch.full((3, 12), value) * weights, weights)


# --- the fit -------------------------------------------------------------------------------------------------------


def test_the_picture_is_row_0_at_the_largest_y() -> None:
    values = torch.zeros(3, 12)
    values[:, 0] = 1.0  # smallest x, smallest y
    values[:, 11] = 0.5  # largest x, largest y
    used = torch.ones(12, dtype=torch.bool)
    used[4] = False
    shown = fit.receiver_picture(values, used, RECEIVER)
    assert shown.shape == (3, 4, 3)
    assert shown[2, 0] == pytest.approx(1)
    assert shown[0, 3] == pytest.approx(0.735, abs=1e-3)  # 0.5 in sRGB
    assert shown[1, 0] == pytest.approx(fit.UNUSED)
    assert shown[1, 1].tolist() == [0, 0, 0]


def test_the_extent_is_the_receivers() -> None:
    assert fit.extent_of(RECEIVER) == (-1.0, 3.0, -2.5, 0.5)


@pytest.mark.parametrize("why", [Rejection.SATURATED, Rejection.SPECULAR, Rejection.ROBUST])
def test_what_was_left_out_has_its_colour_in_two_panels_and_a_legend(why: Rejection) -> None:
    seen = observation()
    plain = pixels(fit.fit_picture(seen, seen.samples, RECEIVER, "mm", "title")).astype(int)
    lost = replace(seen, rejected=torch.where(seen.weights == 0, why.value, 0).to(torch.uint8))
    image = pixels(fit.fit_picture(lost, lost.samples, RECEIVER, "mm", "title")).astype(int)
    colour = np.array([round(255 * part) for part in to_rgba(fit.REJECTED[why][0])[:3]])
    shown, before = ((abs(part[..., :3] - colour).max(axis=-1) <= 1) for part in (image, plain))
    halves = [int(shown[: -len(image) // 6, half].sum()) for half in (slice(0, 480), slice(980, None))]
    assert min(halves) > 2000
    assert int(shown[-len(image) // 6 :].sum()) > 20
    assert int(before.sum()) == 0


def test_a_perfect_fit_leaves_a_white_residual_and_grey_where_nothing_was_used() -> None:
    seen = observation()
    image = pixels(fit.fit_picture(seen, seen.samples, RECEIVER, "mm", "title")).astype(int)
    grey = round(fit.UNUSED * 255)
    assert (abs(image[..., :3] - grey).max(axis=-1) <= 1).mean() > 0.01
    other = pixels(fit.fit_picture(seen, seen.samples + 0.1, RECEIVER, "mm", "title")).astype(int)
    right = slice(2 * image.shape[1] // 3, None)
    assert (image[:, : image.shape[1] // 4] != other[:, : image.shape[1] // 4]).mean() < 0.1  # labels move a little
    assert (image[:, right] != other[:, right]).mean() > 0.2


@pytest.mark.parametrize(
    "text", ["plain", "a$b$\\frac{", "x_{2}$^", "日本の影", "100 %", "", "line\nbreak", "$\\notacommand$"]
)
def test_titles_and_units_are_only_text(text: str) -> None:
    seen = observation()
    assert pixels(fit.fit_picture(seen, seen.samples, RECEIVER, text, text)).ndim == 3


@pytest.mark.parametrize("size", [(4.0, 3.0), (100.0, 0.5), (0.001, 1.0)])
def test_any_receiver_gives_a_picture_of_reasonable_size(size: tuple[float, float]) -> None:
    seen = observation()
    image = pixels(fit.fit_picture(seen, seen.samples, replace(RECEIVER, size=size), "mm", "title"))
    assert 200 < image.shape[0] < 1500
    assert 1000 < image.shape[1] < 2000


# --- both lights, and the story ------------------------------------------------------------------------------------


def coloured(channel: int) -> EnvironmentMap:
    radiance = torch.zeros(3, 16, 32)
    radiance[channel] = 0.5
    return EnvironmentMap(radiance)


def amount(image: np.ndarray, channel: int) -> float:
    others = [k for k in range(3) if k != channel]
    return float((image[..., channel].astype(int) > image[..., others].max(axis=-1).astype(int) + 100).mean())


def test_the_true_light_is_above_the_recovered_one() -> None:
    image = pixels(figures.light_comparison(coloured(0), coloured(2)))
    half = image.shape[0] // 2
    assert amount(image[:half], 0) > 0.5
    assert amount(image[half:], 2) > 0.5
    assert amount(image[half:], 0) == amount(image[:half], 2) == 0


def test_the_overview_shows_photograph_lights_and_second_pose() -> None:
    seen = observation()

    def tinted(values: Tensor) -> Tensor:
        return values * torch.tensor([0.0, 1.0, 0.0])[:, None]

    second = Observation(tinted(seen.samples), seen.weights)
    image = pixels(figures.overview(seen, (coloured(0), coloured(2)), second, second.samples, RECEIVER))
    left, middle, right = np.array_split(image, [int(image.shape[1] / 4.3), int(image.shape[1] * 2.55 / 4.3)], axis=1)
    assert amount(left, 0) == amount(left, 1) == amount(left, 2) == 0
    assert amount(middle, 0) > 0.1
    assert amount(middle, 2) > 0.1
    assert amount(right, 1) > 0.1
    assert_close(torch.tensor(amount(right, 0)), torch.tensor(0.0))
