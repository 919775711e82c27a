"""Scene files: a YAML description of what casts, what receives and what looks, read strictly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera
from torchlight.errors import CalibrationError, SceneError, TorchlightError
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.io import fields
from torchlight.io.cameras import read_lens
from torchlight.io.fields import Field
from torchlight.io.files import MAX_PIXELS, read_bytes, sha256_of
from torchlight.io.images import read_mask
from torchlight.io.occluders import read_occluders
from torchlight.io.photo_keys import photo_keys, reference_keys
from torchlight.io.target_file import read_target
from torchlight.io.yaml_file import read_yaml
from torchlight.light_plane import LightPlane
from torchlight.photo.board_camera import BoardCamera
from torchlight.photo.target import Sheet

_SCENE_KEYS = (
    *("units", "occluders", "occluder_albedo", "occluder_matt", "receiver"),
    *("light", "camera", "photo", "reference", "mask"),
)
_LIGHT_KEYS = ("height", "center")
_RECEIVER_KEYS = ("center", "size", "samples", "albedo")
_CAMERA_KEYS = ("image_size", "K", "distortion", "world_to_camera")
_BOARD_CAMERA_KEYS = ("intrinsics", "board")
_DISTORTION_LENGTHS = (4, 5, 8, 12, 14)


def load_scene(path: str | Path) -> Scene:
    """Returns the scene that a YAML file describes; paths in it are relative to the file.

    `configs/scenes` holds a commented example of each kind.

    Raises:
        FormatError: the file, or a mesh or mask it names, is missing, truncated or not what its name says.
        ConfigError: an unknown or missing key, a wrong type, a tag or a duplicate key.
        SceneError: a degenerate occluder, one that casts no shadow, or a receiver without samples.
        CalibrationError: a camera that cannot be right.
    """
    path = Path(path)
    document, _ = read_yaml(path)
    root = Field(document, path, "")
    known = fields.mapping(root, _SCENE_KEYS)
    occluders = fields.required(known, "occluders", root, "occluders: [{box: [100, 60, 120]}]")
    receiver = fields.required(known, "receiver", root, "receiver: {size: [400, 300], samples: [128, 96]}")
    finder = _board_camera(known["camera"]) if "camera" in known and _names_a_board(known["camera"]) else None
    camera = _camera(known["camera"]) if "camera" in known and finder is None else None
    plane = _receiver(replace(receiver, error=SceneError))
    if finder is not None:
        _check_clear_of_markers(receiver, plane, finder.sheet)
    triangles = read_occluders(replace(occluders, error=SceneError))
    albedo = _occluder_albedo(known["occluder_albedo"]) if "occluder_albedo" in known else 0.0
    light = _light_plane(known["light"], plane, triangles, albedo) if "light" in known else None
    return Scene(
        receiver=plane,
        finder=finder,
        triangles=triangles,
        camera=camera,
        units=fields.text(known["units"]) if "units" in known else "unit",
        mask=_mask(known["mask"], camera) if "mask" in known else None,
        occluder_albedo=albedo,
        occluder_matt=_occluder_matt(known["occluder_matt"]) if "occluder_matt" in known else False,
        light_plane=light,
        **(photo_keys(known["photo"]) if "photo" in known else {}),
        **(reference_keys(known["reference"], receiver) if "reference" in known else {}),
    )


def _receiver(field: Field) -> Receiver:
    known = fields.mapping(field, _RECEIVER_KEYS)
    size = fields.numbers(fields.required(known, "size", field, "size: [400, 300]"), 2)
    samples = fields.integers(fields.required(known, "samples", field, "samples: [128, 96]"), 2)
    center = fields.numbers(known["center"], 2) if "center" in known else (0.0, 0.0)
    albedo = _albedo(known["albedo"]) if "albedo" in known else None
    try:
        return Receiver((center[0], center[1]), (size[0], size[1]), (samples[0], samples[1]), albedo)
    except SceneError as error:
        raise SceneError(f"{field.file}: {error}") from error


def _albedo(field: Field) -> tuple[float, float, float]:
    if isinstance(field.value, list):
        red, green, blue = fields.numbers(field, 3)
        return red, green, blue
    grey = fields.number(field)
    return grey, grey, grey


def _occluder_albedo(field: Field) -> float:
    albedo = fields.number(field)
    if not 0.0 <= albedo < 1.0:
        field.fail(f"expected a number in [0, 1), got {albedo:g}; ebony: 0.05, painted black: 0.04")
    return albedo


def _occluder_matt(field: Field) -> bool:
    if not isinstance(field.value, bool):
        field.fail(f"expected true or false, got {fields.shown(field.value)}")
    return field.value


def _light_plane(field: Field, receiver: Receiver, triangles: Float[Tensor, "faces 3 3"], albedo: float) -> LightPlane:
    known = fields.mapping(field, _LIGHT_KEYS)
    height = fields.positive(fields.required(known, "height", field, "height: 600"))
    center = fields.numbers(known["center"], 2) if "center" in known else receiver.center
    plane = LightPlane(height, (center[0], center[1]))
    try:
        Scene(triangles, receiver, light_plane=plane, occluder_albedo=albedo)  # says what cannot be
    except SceneError as error:
        raise SceneError(f"{field.file}: {error}") from error
    return plane


def _names_a_board(field: Field) -> bool:
    return isinstance(field.value, dict) and not {"intrinsics", "board"}.isdisjoint(field.value)


def _board_camera(field: Field) -> BoardCamera:
    known = fields.mapping(field, _BOARD_CAMERA_KEYS)
    lens = fields.required(known, "intrinsics", field, "intrinsics: camera.json")
    board = fields.required(known, "board", field, "board: target.yaml")
    try:
        files = [field.file.parent / fields.text(named) for named in (lens, board)]
        return BoardCamera(read_lens(files[0]), read_target(files[1]), *(sha256_of(read_bytes(file)) for file in files))
    except TorchlightError as error:
        message = str(error)
        raise error if message.startswith(str(field.file)) else type(error)(field.describe(message)) from error


def _check_clear_of_markers(field: Field, receiver: Receiver, sheet: Sheet) -> None:
    reach = [abs(center) + size / 2 for center, size in zip(receiver.center, receiver.size, strict=True)]
    if reach[0] > sheet.inside[0] / 2 + 1e-9 or reach[1] > sheet.inside[1] / 2 + 1e-9:
        field.fail(
            f"reaches over the sheet's markers; its clean white is {sheet.inside[0]:g} x {sheet.inside[1]:g} mm around "
            f"the origin: for example 'size: [{sheet.inside[0]:g}, {sheet.inside[1]:g}]'"
        )


def _camera(field: Field) -> Camera:
    field = replace(field, error=CalibrationError)
    known = fields.mapping(field, _CAMERA_KEYS)
    width, height = fields.integers(fields.required(known, "image_size", field, "image_size: [1920, 1080]"), 2)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        known["image_size"].fail(
            f"expected two positive integers, at most {MAX_PIXELS:,} pixels, got {width}, {height}"
        )
    intrinsics = fields.matrix(
        fields.required(known, "K", field, "K: [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]]"), 3, 3
    )
    pose = fields.matrix(
        fields.required(known, "world_to_camera", field, "world_to_camera: four rows of four numbers [R|t]"), 4, 4
    )
    distortion = _distortion(known["distortion"]) if "distortion" in known else torch.zeros(5, dtype=torch.float64)
    try:
        return Camera(intrinsics, pose, (width, height), distortion)
    except TorchlightError as error:
        raise CalibrationError(f"{field.file}: {error}") from error


def _distortion(field: Field) -> Tensor:
    expected = f"a list of {', '.join(map(str, _DISTORTION_LENGTHS))} numbers in OpenCV's order k1 k2 p1 p2 k3 ..."
    values = [fields.number(item) for item in fields.items(field, expected)]
    if len(values) not in _DISTORTION_LENGTHS:
        field.fail(f"expected {expected}, got {len(values)}")
    return torch.tensor(values, dtype=torch.float64)


def _mask(field: Field, camera: Camera | None) -> Bool[Tensor, "height width"]:
    file = field.file.parent / fields.text(field)
    try:
        mask = read_mask(file)
    except TorchlightError as error:
        raise type(error)(field.describe(str(error))) from error
    height, width = mask.shape
    if camera is not None and (width, height) != camera.image_size:
        expected = f"{camera.image_size[0]} x {camera.image_size[1]}"
        field.fail(f"{file} has {width} x {height} pixels, but camera.image_size is {expected}; they must agree")
    if not bool(mask.any()):
        field.fail(f"{file} is zero everywhere, so no pixel may be used; paint what may be used in white")
    return mask
