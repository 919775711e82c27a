"""Pictures of lights as PNG bytes: side by side, and beside what they explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from torch import Tensor

from torchlight.drawing.canvas import png_bytes
from torchlight.fit import extent_of, receiver_picture
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import Observation
from torchlight.preview import preview, to_srgb8


def light_comparison(truth: EnvironmentMap, found: EnvironmentMap) -> bytes:
    """Returns a PNG of the upper hemispheres of a true and a recovered light at one exposure, one above the other."""
    figure = Figure(figsize=(9.5, 5.6), dpi=110, layout="constrained")
    draw_lights(list(figure.subplots(2, 1, sharex=True)), truth, found)
    return png_bytes(figure)


def draw_lights(axes: Sequence[Axes], truth: EnvironmentMap, found: EnvironmentMap) -> None:
    """Draws the upper hemispheres of a true and a recovered light at one exposure into two axes."""
    scale = preview(truth).scale
    for axis, light, name in zip(axes, (truth, found), ("true light", "light recovered from the shadow"), strict=True):
        upper = light.radiance[:, : light.height // 2].double() * scale
        axis.imshow(to_srgb8(upper), extent=(180, -180, 0, 90), aspect="auto", interpolation="nearest")
        axis.set_title(name)
        axis.set_ylabel("elevation [degrees]")
        axis.set_yticks([0, 30, 60, 90])
        axis.set_xticks([180, 90, 0, -90, -180])
    axes[-1].set_xlabel("azimuth [degrees], 0 = +x, 90 = +y")


def overview(
    photo: Observation,
    lights: tuple[EnvironmentMap, EnvironmentMap],
    second: Observation,
    relit: Float[Tensor, "3 points"],
    receiver: Receiver,
) -> bytes:
    """Returns the whole story as one PNG: the photograph, the true and the recovered light, a second pose relit.

    Args:
        photo: what the light was recovered from.
        lights: true and recovered.
        second: truth of a pose that was never shown to the solver.
        relit: that pose under the recovered light.
        receiver: the plane of both.
    """
    figure = Figure(figsize=(14.0, 4.6), dpi=110, layout="constrained")
    panels: list[SubFigure] = list(np.array(figure.subfigures(1, 3, width_ratios=(1.0, 1.55, 1.75)), dtype=object))
    left, middle, right = panels
    shown = ((left.subplots(), photo, photo.samples, "1  the photograph"),)
    truth_axis, relit_axis = right.subplots(1, 2, sharey=True)
    shown += ((truth_axis, second, second.samples, "3  another pose: truth"),)
    shown += ((relit_axis, second, relit, "relit by the recovered light"),)
    for axis, observation, values, name in shown:
        used = observation.weights > 0
        white = observation.samples[:, used].max()
        axis.imshow(
            receiver_picture(values / white, used, receiver), extent=extent_of(receiver), interpolation="nearest"
        )
        axis.set_title(name)
        axis.set_xticks([])
        axis.set_yticks([])
    axes = list(middle.subplots(2, 1, sharex=True))
    draw_lights(axes, *lights)
    axes[0].set_title("the true light (not used)")
    axes[1].set_title("2  the light recovered from the shadow")
    return png_bytes(figure)
