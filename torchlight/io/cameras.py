"""Calibrated cameras as files: torchlight's own JSON, OpenCV YAML, COLMAP cameras.txt and Nerfstudio transforms.json.

Pixel centres lie at integers here and in OpenCV, at halves in COLMAP and Nerfstudio: their cx and cy are 0.5 larger.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import torch
import yaml
from jaxtyping import Float
from torch import Tensor

from torchlight.calibration import PARAMETERS, Calibration
from torchlight.camera import Lens
from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.io import fields
from torchlight.io.atomic import write_atomically
from torchlight.io.fields import Field
from torchlight.io.files import one_line, read_bytes

MAX_CAMERA_BYTES = 1 << 24
MAX_OPENCV_LETTERS = 1 << 19  # of YAML, which is slow to read
_NOT_OPENCV = (ValueError, TypeError, AttributeError, LookupError, OverflowError, RuntimeError)
KIND = "torchlight camera"
# camera axes x right, y up, z backward (OpenGL) to OpenCV's
_OPENGL = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
# number of parameters of each COLMAP model, and where fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 are among them
_COLMAP = {
    "SIMPLE_PINHOLE": (3, (0, 0, 1, 2)),
    "PINHOLE": (4, (0, 1, 2, 3)),
    "SIMPLE_RADIAL": (4, (0, 0, 1, 2, 3)),
    "RADIAL": (5, (0, 0, 1, 2, 3, 4)),
    "OPENCV": (8, (0, 1, 2, 3, 4, 5, 6, 7)),
    "FULL_OPENCV": (12, (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11)),
}


def read_lens(path: str | Path) -> Lens:
    """Returns the intrinsics and the distortion in a camera file, told apart by content.

    Raises:
        FormatError: missing, or none of the four formats.
        ConfigError: a wrong type or an unknown camera model.
        CalibrationError: numbers that cannot be a camera.
    """
    path = Path(path)
    data = read_bytes(path, MAX_CAMERA_BYTES)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text file; expected a camera file") from error
    start = text.lstrip()
    read = _lens_of_json if start.startswith("{") else _lens_of_opencv if start.startswith("%YAML") else _lens_of_colmap
    try:
        return read(text, path)
    except TorchlightError as error:
        raise error if str(path) in str(error) else type(error)(f"{path}: {error}") from error


def read_poses(path: str | Path) -> dict[str, Float[Tensor, "4 4"]]:
    """Returns world to camera of every frame of a Nerfstudio transforms.json, by its file_path."""
    path = Path(path)
    document = _json(read_bytes(path, MAX_CAMERA_BYTES).decode("utf-8-sig", "replace"), path)
    root = Field(document, path, "")
    if not isinstance(document, dict) or "frames" not in document:
        root.fail("no frames; expected a Nerfstudio transforms.json")
    poses = {}
    for frame in fields.items(replace(root, value=document["frames"], key="frames"), "a list of frames"):
        value = frame.value
        if not isinstance(value, dict) or not {"file_path", "transform_matrix"} <= set(value):
            frame.fail("expected file_path and transform_matrix")
        matrix = fields.matrix(replace(frame, value=value["transform_matrix"]), 4, 4)
        inverse, singular = torch.linalg.inv_ex(matrix)
        if int(singular) or not bool(torch.isfinite(inverse).all()):
            frame.fail("its transform_matrix cannot be inverted; expected a rotation and a translation")
        poses[str(value["file_path"])] = _OPENGL @ inverse
    return poses


def write_camera(path: str | Path, calibration: Calibration) -> None:
    """Writes a calibration in the format that the name asks for: *.yml or *.yaml, cameras.txt, transforms.json, *.json.

    Raises:
        FormatError: another name, or a place that cannot be written.
        ConfigError: a distortion that the format cannot hold.
    """
    path = Path(path)
    write_atomically(path, writer_for(path)(calibration).encode())


def writer_for(path: str | Path) -> Callable[[Calibration], str]:
    """Returns what writes the format that a file's name asks for; FormatError where it asks for none."""
    name, suffix = Path(path).name.lower(), Path(path).suffix.lower()
    if name == "transforms.json":
        return nerfstudio_text
    if suffix == ".json":
        return camera_text
    if suffix in (".yml", ".yaml"):
        return lambda calibration: opencv_text(calibration.lens)
    if name == "cameras.txt":
        return lambda calibration: colmap_text(calibration.lens)
    raise FormatError(f"{path}: expected a name such as camera.json, camera.yml, cameras.txt or transforms.json")


def camera_text(calibration: Calibration) -> str:
    """Returns torchlight's own camera file: the camera, and the evidence for it."""
    lens = calibration.lens
    deviations = dict(zip(PARAMETERS, calibration.deviations.tolist(), strict=True))
    document = {
        "kind": KIND,
        "image_size": list(lens.image_size),
        "K": lens.intrinsics.tolist(),
        "distortion": lens.distortion.tolist(),
        "rms_pixels": calibration.rms,
        "standard_deviations": {name: value for name, value in deviations.items() if math.isfinite(value)},
        "views": [
            {"name": view.name, "rms_pixels": error, "corners": len(view.points), "world_to_camera": pose.tolist()}
            for view, error, pose in zip(calibration.views, calibration.errors, calibration.poses, strict=True)
        ],
        "rejected": [{"name": each.name, "reason": each.reason} for each in calibration.rejected],
        "rough": calibration.rough,
    }
    return json.dumps(document, indent=1) + "\n"


def opencv_text(lens: Lens) -> str:
    """Returns a camera file of OpenCV's FileStorage, with the keys of its calibration sample."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", lens.image_size[0])
    storage.write("image_height", lens.image_size[1])
    storage.write("camera_matrix", lens.intrinsics.double().numpy())
    storage.write("distortion_coefficients", lens.distortion.double().numpy()[:, None])
    return storage.releaseAndGetString()


def colmap_text(lens: Lens) -> str:
    """Returns a COLMAP cameras.txt: OPENCV, or FULL_OPENCV where k3 to k6 are there; ConfigError beyond k6."""
    values = _up_to_k6(lens, "COLMAP")
    model, count = ("OPENCV", 8) if not any(values[8:]) else ("FULL_OPENCV", 12)
    numbers = " ".join(repr(value) for value in [*_at_halves(values), *values[4:count]])
    width, height = lens.image_size
    return f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {width} {height} {numbers}\n"


def nerfstudio_text(calibration: Calibration) -> str:
    """Returns a Nerfstudio transforms.json, every photograph in its board's world; ConfigError beyond k3."""
    lens = calibration.lens
    values = _up_to_k6(lens, "Nerfstudio")
    if any(values[9:]):
        raise ConfigError("distortion: Nerfstudio has no k4, k5, k6 in OpenCV's sense; calibrate with five parameters")
    fx, fy, cx, cy = _at_halves(values)
    k1, k2, p1, p2, k3 = values[4:9]
    frames = [
        {"file_path": view.name, "transform_matrix": (torch.linalg.inv(pose.double()) @ _OPENGL).tolist()}
        for view, pose in zip(calibration.views, calibration.poses, strict=True)
    ]
    numbers = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": lens.image_size[0], "h": lens.image_size[1]}
    distortion = {"k1": k1, "k2": k2, "k3": k3, "k4": 0.0, "p1": p1, "p2": p2}
    return json.dumps({"camera_model": "OPENCV", **numbers, **distortion, "frames": frames}, indent=1) + "\n"


def _up_to_k6(lens: Lens, program: str) -> list[float]:
    """Returns fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6."""
    k, distortion = lens.intrinsics.tolist(), lens.distortion.tolist()
    if any(distortion[8:]):
        raise ConfigError(f"distortion: {program} holds at most k1 k2 p1 p2 k3 k4 k5 k6, no prism or tilt")
    padded = [*distortion[:8], *[0.0] * (8 - len(distortion))]
    return [k[0][0], k[1][1], k[0][2], k[1][2], *padded]


def _at_halves(values: list[float]) -> list[float]:
    return [values[0], values[1], values[2] + 0.5, values[3] + 0.5]


def _lens(fx: float, fy: float, cx: float, cy: float, size: tuple[int, int], distortion: list[float]) -> Lens:
    k = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
    return Lens(k, size, torch.tensor(distortion, dtype=torch.float64))


def _json(text: str, path: Path) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: not valid JSON: {one_line(str(error))}") from error


def _lens_of_json(text: str, path: Path) -> Lens:
    document = _json(text, path)
    root = Field(document, path, "")
    assert isinstance(document, dict)  # noqa: S101 (it begins with a brace)
    named = {str(key): Field(value, path, str(key)) for key, value in document.items()}
    if "fl_x" in named:
        return _lens_of_nerfstudio(named, root)
    width, height = fields.integers(fields.required(named, "image_size", root, "image_size: [1920, 1080]"), 2)
    k = fields.matrix(fields.required(named, "K", root, "K: [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]]"), 3, 3)
    listed = fields.items(
        fields.required(named, "distortion", root, "distortion: [0, 0, 0, 0, 0]"), "a list of numbers"
    )
    return Lens(k, (width, height), torch.tensor([fields.number(item) for item in listed], dtype=torch.float64))


def _lens_of_nerfstudio(named: Mapping[str, Field], root: Field) -> Lens:
    model = named["camera_model"].value if "camera_model" in named else "OPENCV"
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        root.fail(f"camera_model {fields.shown(model)}: expected OPENCV or PINHOLE; other models are not supported")
    values = {
        key: fields.number(field) for key, field in named.items() if key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
    }
    lacking = [key for key in ("cx", "cy", "w", "h") if key not in values]
    if lacking:
        root.fail(f"{', '.join(lacking)} missing; expected one camera for all frames")
    radial = {key: fields.number(named[key]) if key in named else 0.0 for key in ("k1", "k2", "p1", "p2", "k3", "k4")}
    if radial.pop("k4"):
        root.fail("k4 is not zero: Nerfstudio's k4 multiplies r^8, which OpenCV's model does not have")
    fy = values.get("fl_y", values["fl_x"])
    size = (int(values["w"]), int(values["h"]))
    return _lens(values["fl_x"], fy, values["cx"] - 0.5, values["cy"] - 0.5, size, list(radial.values()))


class _OpenCvLoader(yaml.SafeLoader):
    """Reads OpenCV's matrices as mappings. OpenCV's own parser is not used: damaged files make it corrupt memory."""


def _as_mapping(loader: yaml.SafeLoader, _: str, node: yaml.Node) -> object:
    return loader.construct_mapping(cast(yaml.MappingNode, node), deep=True)


_OpenCvLoader.add_multi_constructor("tag:yaml.org,2002:opencv", _as_mapping)


def _lens_of_opencv(text: str, path: Path) -> Lens:
    if len(text) > MAX_OPENCV_LETTERS:
        raise FormatError(f"{path}: {len(text):,} letters are too many for a camera file; keep the intrinsics alone")
    try:
        # S506: a SafeLoader; the first line, %YAML:1.0, is no YAML
        tree = yaml.load(text.partition("\n")[2], Loader=_OpenCvLoader)  # noqa: S506
        named = tree if isinstance(tree, dict) else {}
        k, distortion = (_opencv_matrix(named.get(key)) for key in ("camera_matrix", "distortion_coefficients"))
        width, height = (float(named.get(key) or 0) for key in ("image_width", "image_height"))
    except (yaml.YAMLError, *_NOT_OPENCV) as error:
        raise FormatError(f"{path}: not a camera file of OpenCV; expected camera_matrix and more") from error
    if k is None or distortion is None:
        raise FormatError(f"{path}: camera_matrix and distortion_coefficients are missing; not a camera of OpenCV")
    if not (0 < width < math.inf and 0 < height < math.inf):
        raise FormatError(f"{path}: image_width and image_height are missing; add the size of the photographs")
    return Lens(k, (int(width), int(height)), distortion.reshape(-1))


def _opencv_matrix(node: Any) -> Tensor | None:
    """Returns a matrix, float64; None where there is none."""
    if node is None:
        return None
    values = torch.tensor([float(value) for value in node["data"]], dtype=torch.float64)
    return values.reshape(int(node["rows"]), int(node["cols"]))


def _lens_of_colmap(text: str, path: Path) -> Lens:
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) != 1:
        raise FormatError(f"{path}: {len(lines)} cameras; expected one, as in a cameras.txt of one shared camera")
    words = lines[0]
    if len(words) < 5 or words[1] not in _COLMAP:
        shown = words[1] if len(words) > 1 else "nothing"
        raise ConfigError(f"{path}: camera model {one_line(shown, 40)}: expected one of {', '.join(_COLMAP)}")
    count, order = _COLMAP[words[1]]
    try:
        width, height, numbers = int(words[2]), int(words[3]), [float(word) for word in words[4:]]
    except ValueError as error:
        raise FormatError(f"{path}: not a cameras.txt of COLMAP: {one_line(str(error))}") from error
    if len(numbers) != count:
        raise FormatError(f"{path}: {words[1]} has {count} parameters, got {len(numbers)}")
    fx, fy, cx, cy, *distortion = [numbers[index] for index in order]
    padded = [*distortion, *[0.0] * (5 - len(distortion))] if len(distortion) < 5 else distortion
    return _lens(fx, fy, cx - 0.5, cy - 0.5, (width, height), padded)
