"""Photographs of the printed sheet by a renderer of the tests' own: ray by ray, lens distortion, blur, noise, 8 bit.

Blur and noise act on linear light; what is stored is sRGB codes.
"""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from torch import Tensor

from torchlight.camera import Camera, Lens
from torchlight.photo.target import DEFAULT_PROP, Sheet, make_sheet
from torchlight.report.sheet import DOTS_PER_INCH, sheet_png

SHEET = make_sheet("A4")
SUPERSAMPLING = 3
INK, WHITE, TABLE = 10.0, 240.0, 60.0  # linear light of 255
LENS = Lens(
    torch.tensor([[1450.0, 0, 801.3], [0, 1455.0, 597.1], [0, 0, 1]], dtype=torch.float64),
    (1600, 1200),
    torch.tensor([0.08, -0.21, 0.0011, -0.0007, 0.05], dtype=torch.float64),
)


@cache
def page(paper: str = "A4") -> NDArray[np.uint8]:
    """Returns the page of a paper as a grey picture."""
    encoded = np.frombuffer(sheet_png(make_sheet(paper), DEFAULT_PROP), dtype=np.uint8)
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def looking_at(place: tuple[float, float, float], at: tuple[float, float, float], roll_degrees: float = 0.0) -> Tensor:
    """Returns world to camera of a camera at a place that looks at a point, from two vectors and cross products."""
    eye, goal = torch.tensor(place, dtype=torch.float64), torch.tensor(at, dtype=torch.float64)
    forward = torch.nn.functional.normalize(goal - eye, dim=0)
    hint = torch.tensor([math.sin(math.radians(roll_degrees)), math.cos(math.radians(roll_degrees)), 0.0]).double()
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, hint), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    return pose


def photograph(
    camera: Camera, seed: int = 0, sheet: Sheet = SHEET, picture: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Returns a grey photograph of the sheet on a grey table: blurred by 0.6 pixels, noise of 1 % of white."""
    picture = page() if picture is None else picture
    width, height = camera.image_size
    photo = np.full((height, width), TABLE)
    rows, columns = _around_the_page(camera, sheet)
    photo[rows, columns] = _rendered(camera, sheet, picture, rows, columns)
    noise = np.random.default_rng(seed).normal(0, 2.55, photo.shape)
    return srgb(photo + noise)


def srgb(light: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Returns the codes of linear light of 255, IEC 61966-2-1."""
    share = np.clip(light / 255, 0, 1)
    code = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
    return np.round(255 * code).astype(np.uint8)


def _around_the_page(camera: Camera, sheet: Sheet) -> tuple[slice, slice]:
    """Returns the rows and columns that may show the page."""
    (x, y), (width, height) = sheet.origin, sheet.paper
    rim = np.array([[a * width - x, b * height - y, 0] for a in (0, 0.5, 1) for b in (0, 0.5, 1)])
    turn, _ = cv2.Rodrigues(camera.world_to_camera[:3, :3].numpy())
    shift = camera.world_to_camera[:3, 3].numpy()
    shown, _ = cv2.projectPoints(rim, turn, shift, camera.intrinsics.numpy(), camera.distortion.numpy())
    low, high = shown.reshape(-1, 2).min(axis=0) - 30, shown.reshape(-1, 2).max(axis=0) + 30
    limits = np.array(camera.image_size)
    low, high = np.clip(low, 0, limits - 1).astype(int), np.clip(high, 1, limits).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def _rendered(
    camera: Camera, sheet: Sheet, picture: NDArray[np.uint8], rows: slice, columns: slice
) -> NDArray[np.float64]:
    points = _plane_points(camera, rows, columns)
    scale = DOTS_PER_INCH / 25.4
    column = ((points[..., 0] + sheet.origin[0]) * scale - 0.5).astype(np.float32)
    row = (len(picture) - (points[..., 1] + sheet.origin[1]) * scale - 0.5).astype(np.float32)
    paper = INK + picture.astype(np.float32) * ((WHITE - INK) / 255)
    seen = cv2.remap(paper, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(TABLE,))
    seen = cv2.GaussianBlur(seen, (0, 0), 0.6 * SUPERSAMPLING)
    count = (rows.stop - rows.start, SUPERSAMPLING, columns.stop - columns.start, SUPERSAMPLING)
    return seen.reshape(count).mean(axis=(1, 3))


def _plane_points(camera: Camera, rows: slice, columns: slice) -> NDArray[np.float64]:
    """Returns where the ray of every fine pixel meets the plane."""
    ideal = _undistorted(_fine(columns), _fine(rows), camera)
    rotation, shift = camera.world_to_camera[:3, :3].numpy(), camera.world_to_camera[:3, 3].numpy()
    eye = -rotation.T @ shift
    directions = ideal @ rotation[:2] + rotation[2]
    return eye[:2] - directions[..., :2] * (eye[2] / directions[..., 2:])


def _fine(pixels: slice) -> NDArray[np.float64]:
    count = (pixels.stop - pixels.start) * SUPERSAMPLING
    return pixels.start + (np.arange(count) + 0.5) / SUPERSAMPLING - 0.5


def _undistorted(x: NDArray[np.float64], y: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Returns the normalized coordinates that OpenCV projects to the pixels, by fixed-point steps.

    The distortion is found on a grid of 16 x 16 nodes and interpolated by cubic splines; what is left of it is smooth.
    """
    k, still = camera.intrinsics.numpy(), np.zeros(3)
    middle, focal = k[:2, 2], k[[0, 1], [0, 1]]
    nodes_x, nodes_y = np.linspace(x[0], x[-1], 16), np.linspace(y[0], y[-1], 16)
    pixels = np.stack(np.meshgrid(nodes_x, nodes_y), axis=-1).reshape(-1, 2)
    plain = (pixels - middle) / focal
    ideal = plain.copy()
    for _ in range(60):
        rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
        shown, _ = cv2.projectPoints(rays, still, still, k, camera.distortion.numpy())
        ideal += (pixels - shown.reshape(-1, 2)) / focal
    bend = (ideal - plain).reshape(16, 16, 2)
    fine = [RectBivariateSpline(nodes_y, nodes_x, bend[..., axis])(y, x) for axis in (0, 1)]
    grid = np.stack(np.meshgrid((x - middle[0]) / focal[0], (y - middle[1]) / focal[1]), axis=-1)
    return grid + np.stack(fine, axis=-1)
