"""Draws docs/images/frames.png: world, samples, camera, pixels and the lat-long picture of the light.

    python scripts/draw_frames.py --out docs/images

Everything is computed by the package from one scene, so that the picture cannot disagree with the code.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.transforms import transform
from torchlight.light.directions import from_angles
from torchlight.light.latlong import image_coordinates

RED, GREEN, BLUE, GREY, SUN = "#D55E00", "#009E73", "#0072B2", "#555555", "#E69F00"
AXIS_COLOURS = (RED, GREEN, BLUE)
RECEIVER = Receiver(center=(0.0, 0.0), size=(4.0, 3.0), samples=(8, 6))
THETA, PHI = math.radians(40), math.radians(150)  # of the sun that is drawn
VIEW_AZIMUTH, VIEW_ELEVATION = math.radians(-68), math.radians(30)
CAMERA, TARGET = np.array([-2.1, -2.6, 1.9]), np.array([0.0, 0.0, 0.0])


def sun() -> np.ndarray:
    """Returns the unit vector towards the sun."""
    return from_angles(*torch.tensor([THETA, PHI], dtype=torch.float64)).numpy()


def paper(points: np.ndarray | list[list[float]]) -> np.ndarray:
    """Returns the orthographic drawing coordinates of world points."""
    a, e = VIEW_AZIMUTH, VIEW_ELEVATION
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    up = np.array([-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)])
    return np.asarray(points, dtype=float) @ np.stack([right, up], axis=1)


def pair(point: np.ndarray) -> tuple[float, float]:
    """Returns a drawing coordinate as matplotlib's annotations want it."""
    return float(point[0]), float(point[1])


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str, label: str, width: float = 2.4) -> None:
    """Draws an arrow between world points with its name at the tip."""
    p, q = paper(start), paper(end)
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 16}
    axes.annotate("", pair(q), pair(p), arrowprops=style, zorder=6)
    tip = q + (q - p) / np.linalg.norm(q - p) * 0.2
    axes.annotate(label, pair(tip), color=colour, fontsize=13, weight="bold", ha="center", va="center", zorder=7)


def solid_faces() -> np.ndarray:
    """Returns the block's triangles, [faces, 3, 3]."""
    return transform(box((0.6, 0.45, 1.0)), 1.0, (0.0, 0.0, 20.0), (0.85, 0.7, 0.0)).numpy()


def draw_world(axes: Axes) -> None:
    """Draws plane, samples, block, shadow, sun and camera in perspective of a bird."""
    (width, height), faces = RECEIVER.size, solid_faces()
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, height / 2, 0]
    axes.add_patch(Polygon(paper(corners), facecolor="0.95", edgecolor="0.4", linewidth=1.2))
    for i in range(1, RECEIVER.samples[0]):
        x = -width / 2 + i * RECEIVER.footprint[0]
        axes.plot(*paper([[x, -height / 2, 0], [x, height / 2, 0]]).T, color="0.8", linewidth=0.7)
    for j in range(1, RECEIVER.samples[1]):
        y = -height / 2 + j * RECEIVER.footprint[1]
        axes.plot(*paper([[-width / 2, y, 0], [width / 2, y, 0]]).T, color="0.8", linewidth=0.7)
    shadow = faces - faces[..., 2:] * (sun() / sun()[2])
    for face in shadow:
        axes.add_patch(Polygon(paper(face), facecolor="0.72", edgecolor="0.72", linewidth=0.8, zorder=2))
    draw_solid(axes, faces)
    for name, colour, tip in zip(("X", "Y", "Z"), AXIS_COLOURS, np.eye(3) * [1.1, 1.1, 1.2], strict=True):
        arrow(axes, np.zeros(3), tip, colour, name)
    first = torch.cat([sample_centers(RECEIVER)[0], torch.zeros(1)]).numpy()
    axes.plot(*paper(first), "o", color=GREY, markersize=5, zorder=5)
    axes.annotate(
        "sample 0",
        pair(paper(first)),
        (4, -26),
        textcoords="offset points",
        fontsize=11,
        color=GREY,
        arrowprops={"arrowstyle": "-", "color": GREY},
    )
    foot = np.array([-0.6, 0.8, 0.0])
    arrow(axes, foot, foot + sun() * 1.7, SUN, "to the light")
    draw_camera(axes)
    axes.set_title("World: +Z towards the light. Camera: x right, y down, z forward.", fontsize=12)
    tidy(axes, (-3.9, 2.5), (-1.4, 2.5))


def draw_solid(axes: Axes, faces: np.ndarray) -> None:
    """Draws the faces that look at the viewer, lit from the sun's side."""
    a, e = VIEW_AZIMUTH, VIEW_ELEVATION
    viewer = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    for face, normal in zip(faces, normals / np.linalg.norm(normals, axis=1, keepdims=True), strict=True):
        if normal @ viewer > 0:
            shade = str(0.35 + 0.3 * max(0.0, float(normal @ sun())))
            axes.add_patch(Polygon(paper(face), facecolor=shade, edgecolor=shade, linewidth=0.8, zorder=4))


def draw_camera(axes: Axes) -> None:
    """Draws the camera's pyramid of view and its axes."""
    forward = (TARGET - CAMERA) / np.linalg.norm(TARGET - CAMERA)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    frame = np.stack([CAMERA + 0.55 * forward + 0.3 * u * right + 0.2 * v * down for u, v in SQUARE])
    axes.add_patch(Polygon(paper(frame), facecolor="white", edgecolor=GREY, alpha=0.8, zorder=5))
    for corner in frame:
        axes.plot(*paper(np.stack([CAMERA, corner])).T, color=GREY, linewidth=1, zorder=5)
    for name, colour, axis in zip(("x", "y", "z"), AXIS_COLOURS, (right, down, forward), strict=True):
        arrow(axes, CAMERA, CAMERA + 0.95 * axis, colour, name)


SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def draw_samples(axes: Axes) -> None:
    """Draws how samples are numbered."""
    receiver = Receiver(center=(0.0, 0.0), size=(4.0, 3.0), samples=(4, 3))
    for index, (x, y) in enumerate(sample_centers(receiver).tolist()):
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor="0.95", edgecolor="0.6"))
        axes.annotate(str(index), (x, y), ha="center", va="center", fontsize=13)
    plane_arrow(axes, (-2.0, -1.75), (-1.0, -1.75), RED, "X")
    plane_arrow(axes, (-2.25, -1.5), (-2.25, -0.5), GREEN, "Y")
    axes.annotate("row 0 of a rectified photograph", (0, 1.62), ha="center", va="bottom", fontsize=11, color=GREY)
    axes.plot([-2, 2], [1.55, 1.55], color=GREY, linewidth=3)
    axes.set_title("samples: [4, 3], seen from above", fontsize=12)
    tidy(axes, (-2.6, 2.3), (-2.1, 2.1))


def draw_pixels(axes: Axes) -> None:
    """Draws where pixel centres lie in a photograph."""
    for x in range(4):
        for y in range(3):
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor="0.95", edgecolor="0.6"))
            axes.annotate(f"{x}, {y}", (x, y), ha="center", va="center", fontsize=12)
    plane_arrow(axes, (-0.5, -0.75), (0.6, -0.75), RED, "x")
    plane_arrow(axes, (-0.75, -0.5), (-0.75, 0.6), GREEN, "y")
    axes.annotate("pixel centres at integers, this corner at (-0.5, -0.5)", (-0.5, -1.2), fontsize=11, color=GREY)
    axes.plot(-0.5, -0.5, "o", color=GREY)
    axes.set_title("image_size: [4, 3], a camera's photograph", fontsize=12)
    tidy(axes, (-1.1, 3.8), (2.8, -1.6))


def draw_latlong(axes: Axes) -> None:
    """Draws where directions lie in the environment map."""
    height = 180
    axes.add_patch(Rectangle((0, 0), 2 * height, height / 2, facecolor="#E8F1FA", edgecolor="0.6"))
    axes.add_patch(Rectangle((0, height / 2), 2 * height, height / 2, facecolor="0.88", edgecolor="0.6"))
    for name, vector, colour in (("+X", (1, 0, 0), RED), ("+Y", (0, 1, 0), GREEN), ("-Y", (0, -1, 0), GREEN)):
        row, column = (value.item() for value in image_coordinates(torch.tensor(vector, dtype=torch.float64), height))
        axes.plot(column, row, "o", color=colour, markersize=7)
        axes.annotate(name, (column, row - 8), ha="center", fontsize=13, weight="bold", color=colour)
    for column, side in ((0, "left"), (360, "right")):
        axes.plot(column, 90, "o", color=RED, markersize=7)
        axes.annotate(
            "-X", (column + (6 if side == "left" else -6), 82), ha=side, fontsize=13, weight="bold", color=RED
        )
    row, column = (value.item() for value in image_coordinates(torch.from_numpy(sun()), height))
    axes.plot(column, row, "*", color=SUN, markersize=18)
    axes.annotate("the light above", (column + 12, row + 4), fontsize=11, color=GREY)
    axes.annotate("row 0: zenith, +Z", (180, 5), ha="center", va="top", fontsize=12, weight="bold", color=BLUE)
    axes.annotate("below the plane: 0 in what is recovered", (180, 140), ha="center", fontsize=11, color=GREY)
    axes.set_title("light.exr: 2:1 lat-long, seen from inside", fontsize=12)
    tidy(axes, (-6, 366), (186, -6))


def plane_arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str, label: str) -> None:
    """Draws a labelled arrow in a panel's own coordinates."""
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 2.4, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 16}
    axes.annotate("", end, start, arrowprops=style)
    direction = np.subtract(end, start)
    tip = np.asarray(end) + 0.18 * direction / np.linalg.norm(direction)
    axes.annotate(label, pair(tip), color=colour, fontsize=13, weight="bold", ha="center", va="center")


def tidy(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Sets the limits and removes the frame."""
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal")
    axes.axis("off")


def main() -> None:
    """Draws the four panels."""
    parser = argparse.ArgumentParser(description="Draws the frames of a scene file.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for frames.png")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(11, 8.2), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
    draw_world(figure.add_subplot(grid[0, 0]))
    draw_samples(figure.add_subplot(grid[0, 1]))
    draw_latlong(figure.add_subplot(grid[1, 0]))
    draw_pixels(figure.add_subplot(grid[1, 1]))
    FigureCanvasAgg(figure).print_png(str(out / "frames.png"))


if __name__ == "__main__":
    main()
