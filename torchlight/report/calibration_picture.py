"""The picture of a calibration: what the boards covered, what is left over, and each photograph's error."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchlight.calibration import Calibration
from torchlight.drawing.canvas import png_bytes

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SHOWN_NAMES = 40


def calibration_picture(calibration: Calibration) -> bytes:
    """Returns a PNG of three panels: coverage of the frame, residuals of all corners, error per photograph."""
    figure = Figure(figsize=(15, 4.6), dpi=110, layout="constrained")
    coverage, residuals, errors = figure.subplots(1, 3, width_ratios=(1.4, 1.0, 1.2))
    draw_coverage(coverage, calibration)
    draw_residuals(residuals, calibration)
    draw_errors(errors, calibration)
    return png_bytes(figure)


def draw_coverage(axis: Axes, calibration: Calibration) -> None:
    """Draws every corner where the photograph shows it, and its residual, enlarged so that it can be seen."""
    width, height = calibration.lens.image_size
    enlarged = 0.02 * width / max(calibration.rms, 1e-6)
    for index, (view, residual) in enumerate(zip(calibration.views, calibration.residuals, strict=True)):
        x, y = view.pixels.T.numpy()
        dx, dy = (residual * enlarged).T.numpy()
        colour = COLOURS[index % len(COLOURS)]
        axis.scatter(x, y, s=3, color=colour)
        axis.plot(np.stack([x, x + dx]), np.stack([y, y + dy]), color=colour, linewidth=0.7)
    axis.set_xlim(-0.5, width - 0.5)
    axis.set_ylim(height - 0.5, -0.5)
    axis.set_aspect("equal")
    axis.set_xlabel("x [pixel]")
    axis.set_ylabel("y [pixel]")
    axis.set_title(f"coverage; residuals {enlarged:.0f} times as long")


def draw_residuals(axis: Axes, calibration: Calibration) -> None:
    """Draws predicted minus seen of every corner, and the circle of the rms."""
    for index, residual in enumerate(calibration.residuals):
        style = {"color": COLOURS[index % len(COLOURS)], "marker": MARKERS[index // len(COLOURS) % len(MARKERS)]}
        axis.scatter(*residual.T.numpy(), s=5, linewidths=0, **style)
    angle = np.linspace(0, 2 * np.pi, 200)
    radius = calibration.rms
    axis.plot(radius * np.cos(angle), radius * np.sin(angle), color="black", linewidth=1)
    reach = 1.05 * torch.cat(calibration.residuals).abs().max().item()
    axis.set_xlim(-reach, reach)
    axis.set_ylim(reach, -reach)
    axis.set_aspect("equal")
    axis.set_xlabel("predicted - seen, x [pixel]")
    axis.set_ylabel("predicted - seen, y [pixel]")
    axis.set_title(f"residuals; circle: rms {radius:.3f} pixel")


def draw_errors(axis: Axes, calibration: Calibration) -> None:
    """Draws one bar per photograph, and names those that were left out."""
    names, errors = [view.name for view in calibration.views], calibration.errors
    axis.barh(range(len(names)), errors, color=[COLOURS[index % len(COLOURS)] for index in range(len(names))])
    axis.axvline(float(np.median(errors)), color="black", linewidth=0.8, linestyle="--")
    labels = names if len(names) <= SHOWN_NAMES else [""] * len(names)
    axis.set_yticks(range(len(names)), labels, fontsize=7, parse_math=False)
    axis.invert_yaxis()
    axis.set_xlabel("rms [pixel]; dashed: median")
    left_out = f"; left out: {len(calibration.rejected)}" if calibration.rejected else ""
    axis.set_title(f"error of {len(names)} photographs{left_out}", parse_math=False)
