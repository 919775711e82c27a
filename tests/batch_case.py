"""A small batch: a post on a plane of 8 x 8 samples, photographed linearly under lights of a few texels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from torchlight.config import Checks, Compute, Config, Light, Output
from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute

SCENE = """
units: mm
occluders: [{box: [20, 20, 60]}]
receiver: {size: [160, 160], samples: [8, 8]}
photo: {encoding: linear}
"""
QUICK = Config(Light("texels", 2), checks=Checks(skip_near_test=True), output=Output(skip_pictures=True))
QUICK_UNCACHED = Config(QUICK.light, checks=QUICK.checks, compute=Compute(no_cache=True), output=QUICK.output)


def write_scene(path: Path) -> Path:
    """Writes the scene file and returns its place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SCENE)
    return path


def write_photos(folder: Path, scene: Path, count: int) -> list[Path]:
    """Writes 16-bit photographs of the scene, each under a light of its own, and returns their places."""
    folder.mkdir(parents=True, exist_ok=True)
    transport = precompute(load_scene(scene), 2, 8, use_cache=False).transport.double()
    random = torch.Generator().manual_seed(1)
    photos = []
    for index in range(count):
        light = torch.rand(3, transport.shape[1], generator=random, dtype=torch.float64)
        shown = (light @ transport.T / torch.pi).reshape(3, 8, 8).flip(1)
        stored = (0.9 * 65535 * shown / shown.max()).round().numpy().astype(np.uint16)
        photos.append(folder / f"p{index:03d}.png")
        cv2.imwrite(str(photos[-1]), stored[::-1].transpose(1, 2, 0))
    return photos


def fingerprints(out: Path) -> dict[str, bytes]:
    """Returns every file of every photograph's folder but its timing, byte by byte."""
    files = sorted((out / "photos").rglob("*"))
    return {
        str(file.relative_to(out)): file.read_bytes() for file in files if file.is_file() and "timing" not in file.name
    }
