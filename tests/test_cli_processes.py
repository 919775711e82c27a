"""Commands that solve, each as a process of its own: what a start leaves out of torch must not be missed later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from workbench import RECTIFIED, light, png, scene_file, shadow

PROGRAM = "from torchlight.cli import program; program()"
SWEEP = """seed: 3
search: {kind: grid}
base: {light: {method: texels, resolution: 4}}
axes: {data.seed: [1]}
data: {synthetic: {lights: [light.exr], samples: 8, seen: {}, held_out: [{rotation_degrees: 50}]}}
"""
CALLS = {
    "the adaptive method": "estimate scene.yaml photo.png --out out --robust",
    "texels": "estimate scene.yaml photo.png --out out --method texels --resolution 4",
    "harmonics": "estimate scene.yaml photo.png --out out --method sh --solver ridge",
    "projected Adam": "estimate scene.yaml photo.png --out out --method texels --resolution 4 --solver adam",
    "a batch": "batch photo.png --scene scene.yaml --out out --workers 0 --method haar --resolution 4",
    "several photographs": "joint views.yaml --out out --resolution 16",
    "a sweep": "sweep sweep.yaml --out out",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("processes")
    scene_file(folder, name="scene.yaml")
    scene_file(folder, RECTIFIED.replace("[0, 0, 20]", "[0, 0, 70]"), "turned.yaml")
    png(folder / "photo.png")
    png(folder / "other.png", 0.9 * shadow())
    light(folder / "light.exr", 16)
    views = ("{scene: scene.yaml, photo: photo.png}", "{scene: turned.yaml, photo: other.png, exposure: 1}")
    (folder / "views.yaml").write_text("photographs:\n" + "".join(f"  - {view}\n" for view in views))
    (folder / "sweep.yaml").write_text(SWEEP)
    return folder


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS.keys())
def test_a_process_has_what_it_needs(folder: Path, tmp_path: Path, call: str) -> None:
    words = [str(tmp_path / word) if word == "out" else word for word in call.split()]
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert (ran.returncode, "Traceback" in ran.stderr) == (0, False), ran.stderr
    assert any((tmp_path / "out").iterdir())
