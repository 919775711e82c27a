"""Triangle meshes from files, as stored: nothing merged or repaired, no materials, nothing executed or fetched."""

from __future__ import annotations

import io
import json
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.io.files import read_bytes, reason

MAX_MESH_BYTES = 2**30
MAX_FACES = 20_000_000
# trimesh's loaders that build geometry from plain data with its required dependencies alone; the others need extra
# packages, unpack archives or hold no triangles
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
_GLB_MAGIC = b"glTF"
_PLY_ELEMENT = re.compile(rb"element\s+(\S+)\s+(\d+)")
_NOT_ASCII = re.compile(rb"[^\x00-\x7f]")
_STL_HEADER, _STL_FACE = 84, 50
_OFF_COUNTS = re.compile(rb"OFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)")


@dataclass(frozen=True)
class _Announced:
    """What a header announces, 0 where it does not: the largest count of anything, and the faces (polygons)."""

    elements: int
    faces: int


def read_mesh(path: str | Path) -> Float[Tensor, "faces 3 3"]:
    """Returns the corners of every triangle, float64, in the file's own unit and axes; polygons are cut into triangles.

    Raises:
        FormatError: missing, an unknown suffix, not such a file, truncated, without faces, NaN or infinite vertices,
            or more than 20 million faces (checked before they are allocated where the file announces them).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise FormatError(f"{path}: '{path.suffix}' is not a mesh format; expected one of {', '.join(MESH_SUFFIXES)}")
    data = read_bytes(path, MAX_MESH_BYTES)
    announced = _announced(data, suffix, str(path))
    if announced.elements > MAX_FACES:
        raise FormatError(
            f"{path}: {announced.elements:,} vertices or faces are more than {MAX_FACES:,}; simplify the mesh"
        )
    triangles = _load(path, data, suffix)
    if len(triangles) == 0:
        raise FormatError(f"{path}: the mesh has no faces; export it with faces, as triangles")
    if len(triangles) < announced.faces:
        raise FormatError(
            f"{path}: truncated: {len(triangles):,} of {announced.faces:,} faces; copy or export it again"
        )
    if len(triangles) > MAX_FACES:
        raise FormatError(f"{path}: {len(triangles):,} faces are more than {MAX_FACES:,}; simplify the mesh")
    if not np.isfinite(triangles).all():
        raise FormatError(f"{path}: some vertices are NaN or infinite; clean or re-export the mesh")
    return torch.from_numpy(np.ascontiguousarray(triangles, dtype=np.float64))


class _Beside:
    """Hands trimesh the regular files in a mesh's folder or below it, and nothing else: no pipe, no device."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def __getitem__(self, name: str) -> bytes:
        place = (self._folder / name).resolve()
        if not place.is_relative_to(self._folder):
            raise ValueError(f"its buffer {name} does not lie in its folder")
        return read_bytes(place, MAX_MESH_BYTES)


def _load(path: Path, data: bytes, suffix: str) -> Any:
    import trimesh

    try:
        # a .gltf names its buffers by files; the other formats are whole, and nothing is fetched for them
        beside: Any = _Beside(path.parent) if suffix == ".gltf" else None
        source = io.BytesIO(data if suffix == ".gltf" else _plain_text(data, suffix))
        mesh = trimesh.load_mesh(source, file_type=suffix[1:], resolver=beside, process=False, skip_materials=True)
        faces = np.asarray(mesh.faces)
        if faces.size and (faces.min() < 0 or faces.max() >= len(mesh.vertices)):
            raise ValueError("a face names a vertex that does not exist")
        return np.asarray(mesh.vertices)[faces]
    except Exception as error:  # loaders raise anything at all on a damaged file
        raise FormatError(f"{path}: not a readable {suffix} mesh: {reason(error)}; re-export it") from error


def _plain_text(data: bytes, suffix: str) -> bytes:
    """Returns text in UTF-8 as trimesh wants it: exporters write names and comments in any encoding."""
    if suffix == ".ply":
        end = _ply_header_end(data)
        return _NOT_ASCII.sub(b"?", data[:end]) + data[end:]
    if suffix == ".glb" or (suffix == ".stl" and _is_binary_stl(data)):
        return data
    if b"\0" in data:
        raise ValueError("it holds binary data that its header does not explain")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def _is_binary_stl(data: bytes) -> bool:
    return len(data) >= _STL_HEADER and len(data) == _STL_HEADER + _STL_FACE * struct.unpack_from("<I", data, 80)[0]


def _ply_header_end(data: bytes) -> int:
    end = data.find(b"end_header", 0, 65_536)
    return end if end >= 0 else min(len(data), 65_536)


def _announced(data: bytes, suffix: str, name: str) -> _Announced:
    try:
        if suffix in (".glb", ".gltf"):
            return _Announced(_gltf_elements(data), 0)
        if suffix == ".ply":
            counts = {kind: int(count) for kind, count in _PLY_ELEMENT.findall(data[: _ply_header_end(data)])}
            return _Announced(max(counts.values(), default=0), counts.get(b"face", 0))
        match = _OFF_COUNTS.search(data, 0, 65_536) if suffix == ".off" else None
        return _Announced(0, 0) if match is None else _Announced(max(int(match[1]), int(match[2])), int(match[2]))
    except (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, struct.error, RecursionError) as error:
        raise FormatError(f"{name}: not a readable {suffix} mesh: {reason(error)}; re-export it") from error


def _gltf_elements(data: bytes) -> int:
    """Returns how many vertices and faces a glTF scene would allocate: every accessor, and every use of a mesh.

    An accessor without a buffer view stands for any number of zeros, and a node may repeat a large mesh, so neither
    is bounded by the size of the file (glTF 2.0, sections 3.6.2.3 and 3.5).
    """
    if data.startswith(_GLB_MAGIC):
        (length,) = struct.unpack_from("<I", data, 12)
        data = data[20 : 20 + length]
    tree = json.loads(data)
    counts = [int(accessor["count"]) for accessor in tree.get("accessors", [])]
    faces = [
        sum(counts[p.get("indices", p["attributes"]["POSITION"])] // 3 for p in mesh["primitives"])
        for mesh in tree.get("meshes", [])
    ]
    placed = sum(faces[node["mesh"]] for node in tree.get("nodes", []) if "mesh" in node)
    return max(max(counts, default=0), placed)
