from __future__ import annotations

import json
import os
import pickle
import struct
from pathlib import Path

import pytest
import torch
import trimesh
from torch.testing import assert_close

from torchlight.errors import FormatError
from torchlight.geometry.primitives import box
from torchlight.io import meshes
from torchlight.io.meshes import read_mesh

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 1 2
3 0 1 3
"""
CORNERS = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1, 0, 0], [0, 0, 1]]], dtype=torch.float64)


def refused(path: Path, *parts: str) -> None:
    with pytest.raises(FormatError) as error:
        read_mesh(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for part in parts:
        assert part in message, message


def test_vertices_as_stored(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(PLY)
    assert_close(read_mesh(tmp_path / "a.ply"), CORNERS, rtol=0, atol=0)


@pytest.mark.parametrize("suffix", meshes.MESH_SUFFIXES)
def test_every_format(tmp_path: Path, suffix: str) -> None:
    solid = box((1.0, 2.0, 4.0))
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(solid.numpy()), process=False)
    if suffix == ".gltf":
        files = mesh.export(file_type="gltf")
        assert isinstance(files, dict)
        for name, data in files.items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    else:
        path = tmp_path / f"a{suffix}"
        mesh.export(path)
    assert_close(read_mesh(path), solid, rtol=0, atol=1e-6)


def test_upper_case_suffix_and_ascii_stl(tmp_path: Path) -> None:
    solid = box((1.0, 2.0, 4.0))
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(solid.numpy()), process=False)
    (tmp_path / "A.STL").write_text(str(mesh.export(file_type="stl_ascii")))
    assert_close(read_mesh(tmp_path / "A.STL"), solid, rtol=0, atol=1e-6)


def test_polygons_become_triangles(tmp_path: Path) -> None:
    corners = "v 0 0 0\nv 2 0 0\nv 3 1 0\nv 2 2 0\nv 0 2 0\n"
    (tmp_path / "a.obj").write_text(corners + "f 1 2 4 5\nf 2 3 4\n")
    (tmp_path / "b.obj").write_text(corners + "f 1 2 3 4 5\n")
    for name in ("a.obj", "b.obj"):
        triangles = read_mesh(tmp_path / name)
        edges = triangles[:, 1:] - triangles[:, :1]
        area = torch.linalg.cross(edges[:, 0], edges[:, 1])[:, 2].sum() / 2
        assert_close(area.item(), 5.0)
        assert len(triangles) == 3


def test_ply_polygons_become_triangles(tmp_path: Path) -> None:
    header = PLY.replace("vertex 4", "vertex 5").replace("face 2", "face 1").split("0 0 0\n")[0]
    (tmp_path / "a.ply").write_text(header + "0 0 0\n2 0 0\n3 1 0\n2 2 0\n0 2 0\n5 0 1 2 3 4\n")
    triangles = read_mesh(tmp_path / "a.ply")
    edges = triangles[:, 1:] - triangles[:, :1]
    assert_close((torch.linalg.cross(edges[:, 0], edges[:, 1])[:, 2].sum() / 2).item(), 5.0)


def test_names_in_other_encodings(tmp_path: Path) -> None:
    text = "# Würfel\no Würfel\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    (tmp_path / "a.obj").write_bytes(text.encode("latin-1"))
    (tmp_path / "a.ply").write_bytes(PLY.replace("ascii 1.0\n", "ascii 1.0\ncomment Würfel\n").encode("latin-1"))
    for name in ("a.obj", "a.ply"):
        assert_close(read_mesh(tmp_path / name), CORNERS, rtol=0, atol=0)


def test_materials_are_not_opened(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").mkdir()
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl b\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    assert_close(read_mesh(tmp_path / "a.obj"), CORNERS, rtol=0, atol=0)


class Payload:
    """What a malicious pickle would do."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("suffix", meshes.MESH_SUFFIXES)
@pytest.mark.parametrize("protocol", [0, 4])
def test_pickles_are_not_run(tmp_path: Path, suffix: str, protocol: int) -> None:
    trace = tmp_path / "ran"
    (tmp_path / f"a{suffix}").write_bytes(pickle.dumps(Payload(trace), protocol=protocol))
    refused(tmp_path / f"a{suffix}")
    assert not trace.exists()


@pytest.mark.parametrize("suffix", meshes.MESH_SUFFIXES)
def test_text_and_empty_files(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text("hello\nthis is text\n")
    refused(path)
    path.write_bytes(b"")
    refused(path, "the file is empty")


def test_missing_folder_and_unknown_suffix(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "a.blend").write_bytes(b"BLENDER")
    refused(tmp_path / "none.ply", "no such file")
    refused(tmp_path / "folder.ply", "got a folder")
    refused(tmp_path / "a.blend", "'.blend' is not a mesh format", ".ply")
    refused(tmp_path / "a.zip", "not a mesh format")


def test_no_faces(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(PLY.replace("face 2", "face 0").split("3 0 1 2", maxsplit=1)[0])
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    for name in ("a.ply", "a.obj"):
        refused(tmp_path / name, "the mesh has no faces")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_vertices_that_are_not_finite(tmp_path: Path, value: str) -> None:
    (tmp_path / "a.ply").write_text(PLY.replace("0 0 1\n", f"0 {value} 1\n"))
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 {value} 0\nf 1 2 3\n")
    for name in ("a.ply", "a.obj"):
        refused(tmp_path / name, "NaN or infinite")


def test_faces_of_missing_vertices(tmp_path: Path) -> None:
    for bad in ("9", "-1"):
        (tmp_path / "a.ply").write_text(PLY.replace("3 0 1 3", f"3 0 1 {bad}"))
        refused(tmp_path / "a.ply", "not a readable .ply mesh")


def test_truncated_files(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    for suffix in (".ply", ".stl", ".glb"):
        data = mesh.export(file_type=suffix[1:])
        assert isinstance(data, bytes)
        for length in (10, 100, len(data) // 2, len(data) - 4):
            (tmp_path / f"a{suffix}").write_bytes(data[:length])
            refused(tmp_path / f"a{suffix}")
    (tmp_path / "a.ply").write_text(PLY[:-8])
    refused(tmp_path / "a.ply", "truncated: 1 of 2 faces")
    (tmp_path / "a.off").write_text("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    refused(tmp_path / "a.off", "truncated: 1 of 2 faces")


def test_announced_sizes_are_refused_before_loading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        pytest.fail("the mesh must not be loaded")

    monkeypatch.setattr(meshes, "_load", fail)
    (tmp_path / "a.ply").write_text(PLY.replace("vertex 4", "vertex 99999999999"))
    (tmp_path / "a.off").write_text("OFF\n# comment\n4 99999999999 0\n0 0 0\n")
    accessor = {"count": 99_999_999, "componentType": 5126, "type": "VEC3"}
    (tmp_path / "a.gltf").write_text(json.dumps({"accessors": [accessor]}))
    document = json.dumps({"accessors": [accessor]}).encode()
    chunk = struct.pack("<II", len(document), 0x4E4F534A) + document
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    for name in ("a.ply", "a.off", "a.gltf", "a.glb"):
        refused(tmp_path / name, "are more than 20,000,000")


def test_repeated_instances_are_counted(tmp_path: Path) -> None:
    tree = {
        "accessors": [{"count": 3_000_000}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}] * 21,
    }
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    refused(tmp_path / "a.gltf", "21,000,000 vertices or faces are more than 20,000,000")


def test_huge_files_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / "a.obj").open("wb") as file:
        os.truncate(file.fileno(), meshes.MAX_MESH_BYTES + 1)
    refused(tmp_path / "a.obj", "more than the limit")
