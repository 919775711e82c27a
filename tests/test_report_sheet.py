"""The page is to scale: in the PDF's own units, and in the picture's pixels."""

from __future__ import annotations

import re
import zlib

import cv2
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.photo.target import DEFAULT_PROP, PAPERS, make_sheet, marker_corners
from torchlight.report.sheet import DOTS_PER_INCH, sheet_pdf, sheet_png

POINTS_PER_MM = 72 / 25.4


def page_stream(pdf: bytes) -> str:
    """Returns the drawing commands: the longest stream of the file."""
    streams = [
        zlib.decompress(body) for body in re.findall(rb"FlateDecode.*?stream\r?\n(.*?)\r?\nendstream", pdf, re.S)
    ]
    return max(streams, key=len).decode("latin1")


@pytest.mark.parametrize("paper", PAPERS)
def test_the_pdf_page_and_its_markers_are_true_to_scale(paper: str) -> None:
    sheet = make_sheet(paper)
    pdf = sheet_pdf(sheet, DEFAULT_PROP)
    box = re.search(rb"/MediaBox \[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", pdf)
    assert box is not None
    assert_close([float(box[1]), float(box[2])], [side * POINTS_PER_MM for side in sheet.paper], atol=1e-3, rtol=0)
    assert b"/Rotate" not in pdf
    assert b"/UserUnit" not in pdf
    numbers = re.findall(r"^(-?[\d.]+) (-?[\d.]+) [ml]$", page_stream(pdf), re.MULTILINE)
    points = torch.tensor([[float(x), float(y)] for x, y in numbers], dtype=torch.float64) / POINTS_PER_MM
    wanted = marker_corners(sheet)[..., :2].reshape(-1, 2) + torch.tensor(sheet.origin, dtype=torch.float64)
    nearest = (wanted[:, None] - points).norm(dim=-1).min(dim=1).values
    assert nearest.max().item() < 1e-3  # mm


def test_the_printed_ruler_is_100_mm_long_in_the_pdf() -> None:
    stream = page_stream(sheet_pdf(make_sheet("A4"), DEFAULT_PROP))
    lines = re.findall(r"^([\d.]+) ([\d.]+) m\n([\d.]+) ([\d.]+) l$", stream, re.MULTILINE)
    lengths = [(float(c) - float(a)) / POINTS_PER_MM for a, b, c, d in lines if b == d]
    assert min(abs(length - 100) for length in lengths) < 1e-3


def test_the_picture_shows_every_marker_where_the_sheet_says() -> None:
    sheet = make_sheet("letter")
    picture = cv2.imdecode(np.frombuffer(sheet_png(sheet, DEFAULT_PROP), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    scale = DOTS_PER_INCH / 25.4
    assert picture.shape[1::-1] == tuple(int(side * scale) for side in sheet.paper)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, identities, _ = detector.detectMarkers(picture)
    assert identities is not None
    order = np.asarray(identities, dtype=np.int64).ravel().tolist()
    assert sorted(order) == list(range(len(sheet.markers)))
    seen = torch.from_numpy(np.concatenate([np.asarray(each).reshape(1, 4, 2) for each in corners])).double()
    wanted = (marker_corners(sheet)[order][..., :2] + torch.tensor(sheet.origin, dtype=torch.float64)) * scale
    wanted[..., 1] = sheet.paper[1] * scale - wanted[..., 1]
    assert_close(seen + 0.5, wanted, atol=1.5, rtol=0)  # the detector returns whole pixels inside the black


def test_the_inside_is_white_but_for_the_footprint() -> None:
    sheet = make_sheet("A4")
    picture = cv2.imdecode(np.frombuffer(sheet_png(sheet, DEFAULT_PROP), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    scale = DOTS_PER_INCH / 25.4
    x, y = np.meshgrid(np.arange(picture.shape[1]), np.arange(picture.shape[0]))
    x, y = (x + 0.5) / scale - sheet.origin[0], sheet.paper[1] - (y + 0.5) / scale - sheet.origin[1]
    inside = (abs(x) < sheet.inside[0] / 2) & (abs(y) < sheet.inside[1] / 2)
    turn = np.radians(DEFAULT_PROP.turn_degrees)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    covered = (abs(along) < DEFAULT_PROP.size[0] / 2) & (abs(across) < DEFAULT_PROP.size[1] / 2)
    assert picture[inside & ~covered].min() == 255
    assert picture[inside & covered].min() < 200
