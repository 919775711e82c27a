"""Inputs that are small and ask for much: memory, time, or files that are none of theirs."""

from __future__ import annotations

import json
import struct
import zlib

from fuzzing.mutations import repaired_png


def bombs(seeds: dict[str, bytes]) -> dict[str, tuple[str, bytes]]:
    """Returns what it is, the file name that says its kind, and the input.

    Args:
        seeds: valid inputs.
    """
    png, exr = seeds["photo8.png"], seeds["light.exr"]
    ply = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nend_header\n"
    return {
        "PNG of 2^31 x 2^31 pixels": ("a.png", repaired_png(sized(png, 2**31 - 1, 2**31 - 1))),
        "PNG of 20,000 x 20,000 pixels in a kilobyte": ("a.png", repaired_png(sized(png, 20_000, 20_000))),
        "PNG of 20,008 x 20,008 zeros, whole and right": ("a.png", zeros_png(20_008)),
        "EXR with a data window of 2^31": ("a.exr", windows(exr, 2**31 - 2, 2**31 - 2)),
        "EXR of 20,000 x 20,000 pixels in a kilobyte": ("a.exr", windows(exr, 19_999, 19_999)),
        "HDR of 20,000 x 20,000 pixels in a kilobyte": ("a.hdr", repeated_hdr(20_000, 20_000)),
        "BMP of 20,000 x 20,000 compressed pixels": ("a.bmp", run_length_bmp(20_000)),
        "PLY of 10^12 vertices": ("a.ply", ply % 10**12),
        "PLY of 10^7 vertices in 90 bytes": ("a.ply", ply % 10**7),
        "OFF of 10^12 faces": ("a.off", b"OFF\n3 1000000000000 0\n"),
        "OFF of comments": ("a.off", b"OFF\n" + b"# " * 60 + b"x"),
        "STL of 2^32 faces": ("a.stl", b"\0" * 80 + b"\xff" * 4 + b"\0" * 100),
        "OBJ whose face names vertex 10^12": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 1000000000000\n"),
        "OBJ whose face has 10^5 corners": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf " + b"1 2 3 " * 33_333),
        "glTF of 10^12 zeros": ("a.gltf", gltf(count=10**12)),
        "glTF of an infinite number of vertices": ("a.gltf", gltf(count=10**9).replace(b"1000000000", b"Infinity")),
        "glTF whose buffer is a device": ("a.gltf", gltf(uri="/dev/zero")),
        "glTF whose buffer is outside": ("a.gltf", gltf(uri="../../../../../../etc/passwd")),
        "glTF whose nodes go round": ("a.gltf", gltf(children=[0])),
        "YAML aliases that double": ("views.yaml", doubling(24)),
        "YAML that holds itself": ("views.yaml", b"photographs: &a [*a, *a]\n"),
        "YAML nested 100,000 deep": ("scene.yaml", b"[" * 100_000),
        "YAML of 10^6 items": ("views.yaml", b"photographs: [" + b"1," * 10**6 + b"]"),
        "YAML that calls": ("scene.yaml", b"!!python/object/apply:os.system ['touch called']\n"),
        "JSON nested 100,000 deep": ("manifest.jsonl", b'{"tags": ' + b"[" * 100_000),
        "JSON of 100,000 keys": ("manifest.jsonl", ("{" + ",".join(f'"{i}":1' for i in range(100_000)) + "}").encode()),
        "a name of 10^5 folders": (
            "manifest.jsonl",
            json.dumps({"photo": "a", "name": "/".join("a" * 10**5)}).encode(),
        ),
        "a name that leads outside": ("manifest.jsonl", b'{"photo": "a", "name": "a/../../../x"}'),
        "a photograph that leads outside": ("manifest.jsonl", b'{"photo": "../../../../../x.png"}'),
        "a tag that is no UTF-8": ("manifest.jsonl", b'{"photo": "a", "tags": {"k": "\\ud800"}}'),
        "a CSV cell of a megabyte": ("manifest.csv", b"photo\n" + b"a" * 10**6),
        "a camera of infinite size": ("camera.yml", seeds["camera.yml"].replace(b"24", b".Inf", 1)),
        "a matrix of 60,000 x 60,000": ("camera.yml", seeds["camera.yml"].replace(b"s: 3", b"s: 60000")),
        "a pose that cannot be inverted": ("transforms.json", seeds["transforms.json"].replace(b"1.0", b"0.0")),
        "a dictionary of 5,000 letters": ("target.yaml", seeds["target.yaml"].replace(b"DICT_4X4_50", b"e" * 5000)),
        "a response beyond floats": ("response.json", seeds["response.json"].replace(b"0.25", b"9" * 400)),
        "a pickle instead of safetensors": (f"{'0' * 64}.safetensors", b"\x80\x04cos\nsystem\n(S'touch called'\ntR."),
    }


def sized(png: bytes, width: int, height: int) -> bytes:
    """Returns a PNG whose header says another size."""
    return png[:16] + struct.pack(">II", width, height) + png[24:]


def zeros_png(side: int) -> bytes:
    """Returns a PNG of one bit per pixel, all black, whole and right."""
    head = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    deflate = zlib.compressobj(9)
    row = b"\0" * (1 + side // 8)
    pixels = b"".join(deflate.compress(row) for _ in range(side)) + deflate.flush()
    chunks = ((b"IHDR", head), (b"IDAT", pixels), (b"IEND", b""))
    body = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def windows(exr: bytes, right: int, top: int) -> bytes:
    """Returns an EXR whose data and display window end elsewhere."""
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        start = exr.index(name) + len(name) + 4
        exr = exr[:start] + struct.pack("<4i", 0, 0, right, top) + exr[start + 16 :]
    return exr


def repeated_hdr(width: int, height: int) -> bytes:
    """Returns an HDR picture whose lines repeat one pixel, as the format's first edition allows."""
    line = bytes([9, 9, 9, 128]) + bytes([1, 1, 1, width - 1 & 255, 1, 1, 1, width - 1 >> 8])
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + line * 60


def run_length_bmp(side: int) -> bytes:
    """Returns a BMP of one byte per pixel, run-length encoded, without pixels."""
    head = struct.pack("<IiiHHIIiiII", 40, side, side, 1, 8, 1, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 1078, 0, 0, 1078) + head + b"\0" * 1024 + b"\0\1"


def gltf(
    count: int = 3, uri: str = "data:application/octet-stream;base64," + "AAAA" * 12, children: list[int] | None = None
) -> bytes:
    """Returns a triangle as glTF."""
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [accessor if count > 3 else {**accessor, "bufferView": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0, "children": children or []}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    return json.dumps(tree).encode()


def doubling(levels: int) -> bytes:
    """Returns a list that names itself twice, level by level."""
    rows = (f" - &a{level} [*a{level - 1}, *a{level - 1}]\n" for level in range(1, levels))
    return ("photographs:\n - &a0 [x, x]\n" + "".join(rows)).encode()
