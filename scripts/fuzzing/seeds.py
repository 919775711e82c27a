"""Valid inputs of every kind that torchlight reads: what mutations begin with."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import cv2
import numpy as np
import torch
import trimesh
import yaml
from safetensors.torch import save

from torchlight.config import Config
from torchlight.io import cache
from torchlight.io.coefficients import write_coefficients
from torchlight.io.config_file import as_yaml
from torchlight.io.exr import write_channels, write_exr
from torchlight.io.rgbe import write_hdr
from torchlight.light.grids import LatlongGrid
from torchlight.light.sampled import SampledLight

KEY = "0" * 64
SCENE = """units: mm
occluders:
  - box: [20, 20, 60]
    rotation_degrees: [0, 0, 20]
    translation: [5, 0, 0]
  - cylinder: {radius: 4, height: 30}
    translation: [40, 0, 0]
  - mesh: mesh.ply
    matrix: [[1, 0, 0, -40], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1]]
receiver: {center: [0, 0], size: [160, 160], samples: [8, 8], albedo: [0.5, 0.4, 0.3]}
camera:
  image_size: [24, 16]
  K: [[30, 0, 11.5], [0, 30, 7.5], [0, 0, 1]]
  distortion: [-0.05, 0.01, 0, 0, 0]
  world_to_camera: [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 700], [0, 0, 0, 1]]
light: {height: 600, center: [10, 0]}
occluder_matt: true
photo: {encoding: gamma, gamma: 2.2}
reference: smooth
mask: mask.png
"""
VIEWS = "photographs:\n  - {scene: a.yaml, photo: a.jpg}\n  - {scene: b.yaml, photo: b.jpg, exposure: 0.5}\n"
TARGET = """paper: [210, 297]
origin: [105, 153.5]
inside: [144, 221]
dictionary: DICT_4X4_50
marker_size: 20
markers: [[-87, -125.5], [87, -125.5], [-87, 125.5], [87, 125.5]]
ruler: {printed: 100, measured: 100}
"""
LINES = (
    {"photo": "a/1.jpg", "scene": "s.yaml", "mask": "m.png", "exposure": 0.5, "name": "x/y", "tags": {"sky": "clear"}},
    {"photo": "b/2.jpg", "scene": "s.yaml", "exposure": "exif"},
)
TABLE = "photo,scene,mask,exposure,name,tags\na/1.jpg,s.yaml,,exif,,sky=clear;hour=9\nb/1.jpg,s.yaml,m.png,2,x/y,\n"
OWN_CAMERA = {
    "kind": "torchlight camera",
    "image_size": [24, 16],
    "K": [[30, 0, 11.5], [0, 30, 7.5], [0, 0, 1]],
    "distortion": [0, 0, 0, 0, 0],
}
TRANSFORMS = {
    "camera_model": "OPENCV",
    **{"fl_x": 30.0, "fl_y": 30.0, "cx": 12.0, "cy": 8.0, "w": 24, "h": 16, "k1": 0.01},
    "frames": [{"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist()}],
}
OPENCV = """%YAML:1.0
---
image_width: 24
image_height: 16
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 30., 0., 11.5, 0., 30., 7.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
"""
SWEEP = """seed: 1
search: {kind: optuna, trials: 4, together: 2}
base: {light: {method: adaptive, resolution: 8}}
axes:
  adaptive.noise: [null, 0.01]
  light.resolution: {low: 8, high: 32, log: true}
data: {synthetic: {lights: [sun_and_window], samples: 8, seen: {}, held_out: [{translation: [1, 0]}]}}
"""
SUMMARY = {"torchlight": "0", "photo": "a.jpg", "method": "texels", "warnings": [], "fit_rms_255": 1.5}
RECORD = {"name": "a", "entry": "1", "state": "failed", "reason": "a.jpg: truncated"}


def texts() -> dict[str, bytes]:
    """Returns the valid inputs that are text, by a file name that says their kind."""
    named = {
        "scene.yaml": SCENE,
        "views.yaml": VIEWS,
        "target.yaml": TARGET,
        "config.yaml": as_yaml(Config()),
        "manifest.jsonl": "\n".join(map(json.dumps, LINES)) + "\n",
        "manifest.csv": TABLE,
        "camera.json": json.dumps(OWN_CAMERA),
        "transforms.json": json.dumps(TRANSFORMS),
        "camera.yml": OPENCV,
        "cameras.txt": "# CAMERA_ID, MODEL\n1 OPENCV 24 16 30 30 12 8 0.1 0 0 0\n",
        "sweep.yaml": SWEEP,
        "result.json": json.dumps(SUMMARY),
        "response.json": json.dumps({name: [0.0, 0.25, 0.5, 1.0] for name in ("red", "green", "blue")}),
        "journal.jsonl": json.dumps(RECORD) + "\n" + json.dumps({**RECORD, "name": "b", "state": "done"}) + "\n",
        "batch.json": json.dumps({"configuration": yaml.safe_load(as_yaml(Config())), "versions": {}}),
    }
    return {name: text.encode() for name, text in named.items()}


def pictures(folder: Path) -> dict[str, bytes]:
    """Returns the valid inputs that are pictures and lights; a folder is needed to write them in."""
    random = np.random.default_rng(1)
    eight, sixteen = (random.integers(1, 2**bits, (16, 24, 3)).astype(f"uint{bits}") for bits in (8, 16))
    found = {
        "photo8.png": encoded(".png", eight),
        "photo16.png": encoded(".png", sixteen),
        "mask.png": encoded(".png", eight[..., 0]),
        "photo.jpg": encoded(".jpg", eight),
        "photo.tiff": encoded(".tiff", sixteen),
        "photo.bmp": encoded(".bmp", eight),
    }
    light = torch.from_numpy(random.random((3, 8, 16))).float()
    write_exr(folder / "light.exr", light, {"convention": "torchlight", "light_plane": {"height": 2, "center": [0, 0]}})
    write_exr(folder / "grey.exr", light[:1], {})
    write_hdr(folder / "light.hdr", light)
    write_exr(folder / "angular.exr", light[..., :8], {"convention": "angular", "primaries": "acescg"})
    write_hdr(folder / "cross.hdr", light[..., :6])
    written = ("light.exr", "grey.exr", "light.hdr", "angular.exr", "cross.hdr")
    return found | {name: (folder / name).read_bytes() for name in written}


def results(folder: Path) -> dict[str, bytes]:
    """Returns the valid inputs that an estimate and an analysis write beside the light; written into a folder first."""
    share = torch.from_numpy(np.random.default_rng(2).random((8, 16))).float()
    write_channels(folder / "confidence.exr", {"observability": share, "deviation.R": share}, {})
    write_exr(folder / "observability.exr", share[None], {"R": "resolution matrix"})
    light = SampledLight(share.flatten().expand(3, -1).contiguous(), LatlongGrid(8), True)
    write_coefficients(folder / "light.json", light, 2, {}, cosine_convolved=True, primaries="acescg")
    tensors = {"coefficients": torch.arange(6.0).reshape(3, 2)}
    written = ("confidence.exr", "observability.exr", "light.json")
    return {name: (folder / name).read_bytes() for name in written} | {"estimate.safetensors": save(tensors)}


def encoded(suffix: str, pixels: np.ndarray) -> bytes:
    """Returns a picture's file."""
    return cv2.imencode(suffix, pixels)[1].tobytes()


def meshes() -> dict[str, bytes]:
    """Returns the valid inputs that are meshes."""
    box = trimesh.creation.box((20.0, 20.0, 60.0))
    kinds = {"mesh.ply": "ply", "mesh.obj": "obj", "mesh.off": "off", "mesh.stl": "stl", "ascii.stl": "stl_ascii"}
    files: dict[str, Any] = {name: box.export(file_type=kind) for name, kind in kinds.items()}
    files |= {"ascii.ply": box.export(file_type="ply", encoding="ascii"), "mesh.glb": box.export(file_type="glb")}
    files |= dict(cast(Any, trimesh.Scene(box).export(file_type="gltf")))
    return {name: data.encode() if isinstance(data, str) else bytes(data) for name, data in files.items()}


def cached(folder: Path) -> dict[str, bytes]:
    """Returns a cache file, written into the folder that is the cache meanwhile."""
    with patch.dict(os.environ, {cache.FOLDER_VARIABLE: str(folder)}):
        cache.store(KEY, {"a": torch.arange(6.0).reshape(2, 3)}, {"by": "a test"})
    return {f"{KEY}.safetensors": (folder / f"{KEY}.safetensors").read_bytes()}


def seeds(folder: Path) -> dict[str, bytes]:
    """Returns every valid input by its file name; they name each other as files of one folder."""
    return texts() | pictures(folder) | results(folder) | meshes() | cached(folder)
