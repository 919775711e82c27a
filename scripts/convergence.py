"""How many directions the transport needs: its error against the block's analytic shadow.

    python scripts/convergence.py --out docs/images

writes convergence.png and convergence.csv and prints a Markdown table. A block of 1.0 x 0.6 x 1.2, turned by 20
degrees, stands on [-2, 2]^2 with 64 x 64 samples under two lights that are uniform within each of the 768 texels:
heavy-tailed random texels, exp(1.7 N(0, 1)), and the built-in sky with a sun and a window, averaged to texels. The
truth is the closed form of `geometry.analytic_shadow` over 53 x 53 directions per texel, a number that shares no
divisor with any of the transport's. Seconds are processor time, summed over threads.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block, block_irradiance
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver, receiver_points
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import scene_occlusion
from torchlight.light import cubemap
from torchlight.light.overlap import latlong_to_texels
from torchlight.light.procedural import sun_and_window
from torchlight.metrics import rms_255
from torchlight.precomputation import DIRECTIONS_PER_EDGE
from torchlight.synthetic import block_scene
from torchlight.threads import ordered_map
from torchlight.transfer import transport

RECEIVER = Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(64, 64))
BLOCK = Block((1.0, 0.6, 1.2), rotation_degrees=20.0)
RESOLUTION = 16
TRUTH_CELLS = 53
FOOTPRINTS, CENTERS = "over footprints", "at sample centres"
RUNS = (
    *((FOOTPRINTS, 16, s) for s in (2, 4, 6, 8, 12, 16, 24)),
    *((CENTERS, 16, s) for s in (2, 4, 6, 8, 12)),
    (FOOTPRINTS, 32, 6),
    (FOOTPRINTS, 64, 3),
)
EIGHT_BIT = 12**-0.5  # RMS error of rounding to integers
LIGHTS = {"random texels": "#0072B2", "sky, sun and window": "#D55E00"}  # Okabe and Ito's palette


@dataclass(frozen=True)
class Row:
    """One transport: how it was made, what it cost, its error under each light in 255ths of the brightest sample."""

    origins: str
    resolution: int
    subsamples: int
    errors: tuple[float, ...]
    seconds: float

    @property
    def directions(self) -> int:
        """Directions along a cube edge."""
        return self.resolution * self.subsamples


def lights() -> Float[Tensor, "lights*3 texels"]:
    """Returns the RGB radiance of the texels under each light, one light after the other."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(3, cubemap.texel_count(RESOLUTION), generator=generator, dtype=torch.float64)
    return torch.cat([(1.7 * noise).exp(), latlong_to_texels(sun_and_window(512).radiance, RESOLUTION)])


def truth(radiance: Float[Tensor, "channels texels"], cells: int) -> Float[Tensor, "channels points"]:
    """Returns E by the analytic shadow, over cells x cells directions per texel."""
    parts = cubemap.texel_cells(RESOLUTION, cells)
    directions = cubemap.cell_directions(parts).float().reshape(-1, 3)
    fluxes = cubemap.cell_cosine_weights(parts).flatten().float() * radiance.float().repeat_interleave(cells**2, dim=1)
    return block_irradiance(BLOCK, directions, fluxes.T.contiguous(), RECEIVER)


def transport_at_centers(scene: Scene, resolution: int, subsamples: int) -> Float[Tensor, "points texels"]:
    """Returns the transport whose rays all start at the samples' centres."""
    cells = cubemap.texel_cells(resolution, subsamples)
    directions = cubemap.cell_directions(cells).numpy()
    weights = cubemap.cell_cosine_weights(cells).float()
    points, test = receiver_points(scene.receiver), scene_occlusion(scene)
    still = np.zeros((subsamples**2, 2))

    def column(texel: int) -> Tensor:
        hidden = test.hidden_on_plane(points, directions[texel], still)
        return weights[texel] @ (1.0 - torch.from_numpy(hidden).float())

    return torch.stack(list(ordered_map(column, range(len(directions)))), dim=1)


def transport_over_footprints(scene: Scene, resolution: int, subsamples: int) -> Float[Tensor, "points texels"]:
    """Returns the transport that the library uses."""
    return transport(scene, resolution, subsamples).transport


TRANSPORTS: dict[str, Callable[[Scene, int, int], Tensor]] = {
    FOOTPRINTS: transport_over_footprints,
    CENTERS: transport_at_centers,
}


def refined(radiance: Float[Tensor, "channels texels"], factor: int) -> Float[Tensor, "channels finer"]:
    """Returns the same light on texels `factor` times smaller."""
    faces = cubemap.scatter_to_faces(radiance, RESOLUTION)
    return cubemap.gather_from_faces(faces.repeat_interleave(factor, dim=-1).repeat_interleave(factor, dim=-2))


def errors(
    predicted: Float[Tensor, "channels points"], expected: Float[Tensor, "channels points"], weights: Tensor
) -> tuple[float, ...]:
    """Returns rms_255 under each light."""
    pairs = zip(predicted.split(3), expected.split(3), strict=True)
    return tuple(rms_255(p.double(), e.double(), weights.double()).item() for p, e in pairs)


def measure() -> list[Row]:
    """Returns one row per run; prints the truth's own error first."""
    scene, radiance = block_scene(BLOCK, RECEIVER), lights()
    weights = visible_samples(scene).float()
    expected = truth(radiance, TRUTH_CELLS)
    coarser = errors(truth(radiance, 41), expected, weights)
    print(f"truth with 41 instead of {TRUTH_CELLS} cells per texel edge: {', '.join(f'{e:.4f}' for e in coarser)}\n")
    transport(scene, 1, 1)  # compiles
    rows = []
    for origins, resolution, subsamples in RUNS:
        start = time.process_time()
        matrix = TRANSPORTS[origins](scene, resolution, subsamples)
        seconds = time.process_time() - start
        predicted = refined(radiance, resolution // RESOLUTION) @ matrix.double().T
        rows.append(Row(origins, resolution, subsamples, errors(predicted, expected, weights), seconds))
    return rows


def markdown(rows: list[Row]) -> str:
    """Returns the rows as a table."""
    head = ["origins", "texels per edge", "s", "directions per edge", *LIGHTS, "processor seconds"]
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " ---: |" * (len(head) - 1)]
    for row in rows:
        cells = [row.origins, row.resolution, row.subsamples, row.directions]
        cells += [f"{error:.3f}" for error in row.errors] + [f"{row.seconds:.1f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def write_csv(path: Path, rows: list[Row]) -> None:
    """Writes the rows with four digits."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = ["origins", "resolution", "subsamples", "directions_per_edge"]
        writer.writerow([*head, *(f"rms_255 {name}" for name in LIGHTS), "processor_seconds"])
        for row in rows:
            numbers = [f"{value:.4f}" for value in row.errors]
            writer.writerow(
                [row.origins, row.resolution, row.subsamples, row.directions, *numbers, f"{row.seconds:.2f}"]
            )


def draw(path: Path, rows: list[Row]) -> None:
    """Draws the error over the number of directions, both axes logarithmic."""
    figure = Figure(figsize=(7.2, 4.8), dpi=150, layout="constrained")
    axes = figure.subplots()
    for light, (name, colour) in enumerate(LIGHTS.items()):
        for origins, style in ((CENTERS, "o--"), (FOOTPRINTS, "s-")):
            line = [row for row in rows if row.origins == origins and row.resolution == RESOLUTION]
            x, y = [row.directions for row in line], [row.errors[light] for row in line]
            axes.plot(x, y, style, color=colour, linewidth=2, markersize=6, label=f"{name}; {origins}")
    axes.axvline(DIRECTIONS_PER_EDGE, color="0.6", linewidth=8, alpha=0.4, zorder=0)
    axes.annotate("default", (DIRECTIONS_PER_EDGE, 0.97), xycoords=("data", "axes fraction"), ha="center", va="top")
    axes.axhline(EIGHT_BIT, color="0.4", linewidth=1.5, linestyle=":")
    axes.annotate(
        "rounding of an\n8-bit photograph",
        (384, EIGHT_BIT),
        (0, -26),
        textcoords="offset points",
        ha="right",
        fontsize=10,
    )
    label_axes(axes, sorted({row.directions for row in rows}))
    axes.legend(loc="lower left", frameon=False, fontsize=10, handlelength=3.5)
    FigureCanvasAgg(figure).print_png(str(path))


def label_axes(axes: Axes, ticks: list[int]) -> None:
    """Sets scales, ticks and labels."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(ticks, [str(tick) for tick in ticks], fontsize=12)
    axes.set_xticks([], minor=True)
    axes.set_yticks(
        [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1],
        ["0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"],
        fontsize=12,
    )
    axes.set_yticks([], minor=True)
    axes.set_xlabel("directions along a cube edge", fontsize=13)
    axes.set_ylabel("RMS error of the receiver\n[1/255 of its brightest sample]", fontsize=13)
    axes.grid(color="0.9")


def main() -> None:
    """Measures, writes, prints."""
    parser = argparse.ArgumentParser(description="Error of the transport against the analytic shadow.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the figure and the CSV")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    rows = measure()
    write_csv(out / "convergence.csv", rows)
    draw(out / "convergence.png", rows)
    print(markdown(rows))


if __name__ == "__main__":
    main()
