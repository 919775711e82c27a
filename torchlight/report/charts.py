"""Curves of an analysis as PNG bytes: nullity, spectra, sampling directions, singular values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.analysis.nullity import CONSIDERABLY_LESS_THAN_1, TOLERANCE, Nullity
from torchlight.analysis.sampling import sampling_set
from torchlight.analysis.spectrum import clamped_cosine
from torchlight.drawing.canvas import png_bytes
from torchlight.report.case import Case, View

# Okabe and Ito's palette, told apart with every common colour blindness; markers and dashes say the same again
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", "-.", ":")
SHOWN_NULLITY = 6.0
CIRCLES = (math.pi / 8, math.pi / 4, math.pi / 2)


def nullity_picture(cases: Sequence[Case], pictures: Mapping[str, np.ndarray]) -> bytes:
    """Returns Fig. 3: per case the scene's picture, the samples that are used, and nullity against bandwidth.

    Args:
        cases: one row each.
        pictures: 8-bit picture of each scene by the name of its case.
    """
    figure = Figure(figsize=(14.5, 3.8 * len(cases)), dpi=110, layout="constrained")
    axes = figure.subplots(len(cases), 3, squeeze=False, width_ratios=(1.25, 1.0, 1.3))
    for case, (scene_axis, samples_axis, curve_axis) in zip(cases, axes, strict=True):
        scene_axis.set_axis_off()
        scene_axis.set_title(case.name, parse_math=False)
        if len(case.views) == 1:
            scene_axis.imshow(pictures[case.name])
            draw_samples(samples_axis, case.views[0])
        else:
            scene_axis.text(0.5, 0.5, f"{len(case.views)} scenes, one light", ha="center")
            samples_axis.set_axis_off()
        draw_nullity(curve_axis, case.curve, case.ideal)
    return png_bytes(figure)


def draw_samples(axis: Axes, item: View) -> None:
    """Draws the receiver from above: samples that are used, left out, and under an occluder."""
    columns, rows = item.scene.receiver.samples
    levels = item.used.double() + item.uncovered.double() * 0.55
    (x, y), (width, height) = item.scene.receiver.center, item.scene.receiver.size
    extent = (x - width / 2, x + width / 2, y - height / 2, y + height / 2)
    image = levels.clamp(max=1).reshape(rows, columns).flip(0).numpy()
    axis.imshow(image, extent=extent, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    axis.set_title(f"{int(item.used.sum())} of {len(item.used)} samples used (white)")
    axis.set_xlabel(f"x [{item.scene.units}]", parse_math=False)
    axis.set_ylabel(f"y [{item.scene.units}]", parse_math=False)


def draw_nullity(axis: Axes, curve: Nullity, ideal: Nullity) -> None:
    """Draws mean and standard deviation of the nullity against B, one curve per tolerance."""
    bandwidths = np.arange(1, curve.mean.shape[1] + 1)
    for k, tolerance in enumerate(curve.tolerances):
        mean, deviation = curve.mean[k].numpy(), curve.deviation[k].numpy()
        label = tolerance if isinstance(tolerance, str) else f"{tolerance:.0e}"
        label += f": B = {curve.recommended(tolerance)}"
        shift = 0.06 * (k - (len(curve.tolerances) - 1) / 2)  # so that equal curves do not hide each other
        style = {"color": COLOURS[k], "marker": MARKERS[k], "linestyle": DASHES[k % 4], "markersize": 5}
        axis.errorbar(bandwidths + shift, mean, deviation, capsize=3, linewidth=1.5, label=label, **style)
    best = ideal.mean[curve.tolerances.index(TOLERANCE)].numpy()
    axis.plot(
        bandwidths, best, color="0.45", linewidth=1, label=f"{TOLERANCE:.0e}, were all seen: B = {ideal.recommended()}"
    )
    axis.axhline(CONSIDERABLY_LESS_THAN_1, color="0.6", linewidth=0.8, linestyle=(0, (6, 4)))
    axis.set_ylim(-0.3, SHOWN_NULLITY)
    axis.set_xticks(bandwidths)
    axis.set_xlabel("bandwidth B (l < B)")
    axis.set_ylabel("nullity, mean and deviation")
    title = f"tolerance: largest B\nbelow {CONSIDERABLY_LESS_THAN_1:g} (dashed)"
    axis.legend(title=title, fontsize=8, title_fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def spectrum_picture(cases: Sequence[Case]) -> bytes:
    """Returns slices of the transfer function as in Fig. 1, and its energy per degree beside the clamped cosine's."""
    single = [case for case in cases if len(case.views) == 1]
    figure = Figure(figsize=(12.0, 3.8 * len(single)), dpi=110, layout="constrained")
    axes = figure.subplots(len(single), 2, squeeze=False)
    for case, (slice_axis, energy_axis) in zip(single, axes, strict=True):
        draw_slices(slice_axis, case)
        draw_energy(energy_axis, case)
    return png_bytes(figure)


def draw_slices(axis: Axes, case: Case) -> None:
    """Draws V cos(theta) of some samples, each raised above the one before, over the full cosine."""
    shown = case.spectrum.slices
    degrees = torch.rad2deg(shown.angle_radians).numpy()
    for k, values in enumerate(shown.values.numpy()):
        raised = 1.15 * k
        axis.plot(degrees, np.cos(np.radians(degrees)) + raised, color="0.5", linewidth=1, linestyle="--")
        axis.fill_between(degrees, raised, values + raised, color=COLOURS[k], alpha=0.35, linewidth=0)
        axis.plot(degrees, values + raised, color=COLOURS[k], linewidth=1.5)
        position = int(shown.samples[k])
        axis.text(-88, raised + 0.72, f"sample {position}", fontsize=8, color="0.2")
    axis.set_xticks([-90, -45, 0, 45, 90])
    axis.set_yticks([])
    axis.set_xlabel("angle from the normal [degrees], positive towards the object")
    axis.set_title(f"{case.name}: V cos(theta), dashed without shadows", parse_math=False)


def draw_energy(axis: Axes, case: Case) -> None:
    """Draws the energy per degree over 2l + 1: mean over the used samples, the middle 80 %, and no shadows."""
    energy = case.spectrum.energy
    degrees = torch.arange(energy.shape[1], dtype=torch.float64)
    flat = energy / (2 * degrees + 1)
    low, high = torch.quantile(flat, torch.tensor([0.1, 0.9], dtype=flat.dtype), dim=0).numpy()
    axis.fill_between(degrees.numpy(), low, high, color=COLOURS[0], alpha=0.25, linewidth=0, label="80 % of samples")
    axis.plot(degrees.numpy(), flat.mean(dim=0).numpy(), color=COLOURS[0], marker="o", label="mean over used samples")
    open_plane = (clamped_cosine(energy.shape[1] - 1).square() / (2 * degrees + 1)).numpy()
    lit = open_plane > 0
    axis.plot(degrees.numpy()[lit], open_plane[lit], color=COLOURS[4], marker="v", linestyle="--", label="no shadows")
    axis.set_yscale("log")
    axis.set_ylim(bottom=max(1e-7, float(flat.mean(dim=0).min()) * 1e-2))
    axis.set_xlabel("degree l")
    axis.set_ylabel("energy per degree / (2l + 1)")
    axis.legend(fontsize=8)
    axis.set_title(f"{case.name}: spectrum of the transfer function", parse_math=False)


def directions_picture(bandwidths: Sequence[int]) -> bytes:
    """Returns Fig. 2: the sampling directions projected onto the plane, for some bandwidths."""
    figure = Figure(figsize=(4.2 * len(bandwidths), 4.5), dpi=110, layout="constrained")
    for axis, bandwidth in zip(figure.subplots(1, len(bandwidths), squeeze=False)[0], bandwidths, strict=True):
        directions = sampling_set(bandwidth).directions
        upper = directions[directions[:, 2] >= -1e-12].numpy()
        turn = np.linspace(0, 2 * math.pi, 181)
        for angle in CIRCLES:
            axis.plot(math.sin(angle) * np.cos(turn), math.sin(angle) * np.sin(turn), color="0.6", linewidth=0.8)
            axis.text(
                0, math.sin(angle), f"{math.degrees(angle):g}°", fontsize=7, color="0.4", ha="center", va="bottom"
            )
        axis.plot(upper[:, 0], upper[:, 1], linestyle="none", marker="o", markersize=5, color=COLOURS[0])
        axis.set_aspect("equal")
        axis.set_axis_off()
        axis.set_title(f"B = {bandwidth}: {len(directions)} directions, {len(upper)} in or above the plane", fontsize=9)
    return png_bytes(figure)


def singular_values_picture(cases: Sequence[Case], noise: float) -> bytes:
    """Returns the singular values of the texel transport, in units of the noise, and the degrees of freedom."""
    figure = Figure(figsize=(7.5, 4.6), dpi=110, layout="constrained")
    axis = figure.subplots()
    for k, case in enumerate(cases):
        values: Float[Tensor, " values"] = case.seen.singular_values
        label = f"{case.name}: {case.seen.degrees_of_freedom:.0f} degrees of freedom"
        index = np.arange(1, len(values) + 1)
        axis.plot(index, values.numpy(), color=COLOURS[k % 7], linestyle=DASHES[k % 4], label=label)
    axis.axhline(1, color="0.6", linewidth=0.8)
    axis.text(len(cases[0].seen.singular_values), 1.15, "noise", ha="right", fontsize=8, color="0.4")
    axis.set_yscale("log")
    axis.set_ylim(bottom=1e-6)
    axis.set_xlabel("number")
    n = cases[0].seen.resolution
    axis.set_ylabel("singular value / noise deviation")
    axis.set_title(f"texel transport at {n}x{n}, noise {noise:.3g} of the brightest sample")
    for text in axis.legend(fontsize=8).get_texts():
        text.set_parse_math(False)
    return png_bytes(figure)
