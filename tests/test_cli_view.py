"""`torchlight view`: it answers in a browser, ends on Ctrl-C, and says in one line what it lacks."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from safetensors.torch import save
from workbench import BOX, LINEAR, scene_file
from workbench import torchlight as run

from torchlight.cli import arguments, view
from torchlight.io.exr import write_exr
from torchlight.light.procedural import sun_and_window
from torchlight.viewer import window
from torchlight.viewer.meshes import dome_mesh

SCENE = BOX + "receiver: {size: [4, 4], samples: [8, 8]}\n" + LINEAR
QUICK = ("--resolution", "4", "--no-cache")
NEEDS_VISER = "needs the extra viewer: pip install 'torchlight[viewer]'"


def results(folder: Path, points: int = 64, scene_sha256: str = "") -> Path:
    """Writes what the viewer reads of a result."""
    folder.mkdir()
    content = {"photo": "elsewhere/photo.png", "rms_255": 0.25, "scene_sha256": scene_sha256}
    (folder / "result.json").write_text(json.dumps(content))
    tensors = {"samples": torch.rand(3, points), "weights": torch.ones(points)}
    (folder / "estimate.safetensors").write_bytes(save(tensors))
    write_exr(folder / "light.exr", sun_and_window(16).radiance.float(), {"convention": "torchlight"})
    return folder


def test_results_are_shown_with_their_photograph(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, SCENE)
    shown = view.prepare(arguments.View(results(tmp_path / "r"), scene, resolution=4, no_cache=True))
    assert shown.layers == ("observed", "predicted", "residual")
    assert shown.light.height == 16
    text = "\n".join(shown.lines)
    assert "photo.png, RMS 0.25 of 255" in text
    assert "not the file that these results were made with" in text
    other = view.prepare(arguments.View(results(tmp_path / "s", 9), scene, resolution=4, no_cache=True))
    assert other.layers == ("predicted",)
    assert "not those of this scene" in other.lines[-1]


def test_a_scene_alone_has_a_sky(tmp_path: Path) -> None:
    shown = view.prepare(arguments.View(scene_file(tmp_path, SCENE), resolution=4, no_cache=True))
    assert shown.layers == ("predicted",)
    assert shown.lines[-1] == "light: built-in sky"


def test_the_dome_is_a_glb_that_shines() -> None:
    image = np.zeros((8, 32, 3), dtype=np.uint8)
    image[:, :16] = 200
    loaded = trimesh.load_scene(BytesIO(window.textured(dome_mesh(1.0, 4, 8), image)), file_type="glb")
    (mesh,) = loaded.geometry.values()
    assert mesh.faces.shape == (64, 3)
    assert np.asarray(mesh.visual.material.emissiveTexture).shape == (8, 32, 3)
    assert mesh.visual.material.doubleSided is False


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("none.yaml",), "no such file"),
        (("scene.yaml", "--port", "0"), "--port"),
        (("scene.yaml", "--resolution", "5"), "--resolution"),
        (("scene.yaml", "--light", "none.exr"), "none.exr"),
        (("scene.yaml", "--scene", "scene.yaml"), "--scene"),
        (("folder",), "--scene SCENE"),
        (("folder", "--scene", "scene.yaml"), "result.json"),
    ],
)
def test_what_cannot_be_shown_is_said_in_one_line(
    options: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(view, "viser_module", lambda: None)
    scene_file(tmp_path, SCENE)
    (tmp_path / "folder").mkdir()
    ran = run("view", *options)
    assert ran.code == 2
    assert said in ran.line


def test_damaged_results_are_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "viser_module", lambda: None)
    scene, folder = scene_file(tmp_path, SCENE), results(tmp_path / "r")
    assert "name one of its folders: r" in run("view", tmp_path, "--scene", scene).line
    (folder / "estimate.safetensors").write_bytes(b"nothing")
    assert "run torchlight estimate again" in run("view", folder, "--scene", scene).line
    (folder / "result.json").write_text("[]")
    assert "JSON object" in run("view", folder, "--scene", scene).line
    (folder / "result.json").write_text("{")
    assert "not JSON" in run("view", folder, "--scene", scene).line


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    ran = run("view", scene_file(tmp_path, SCENE))
    assert (ran.code, "pip install 'torchlight[viewer]'" in ran.line) == (2, True)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def page(address: str, seconds: float = 180) -> str:
    """Returns what a server answers, once it does."""
    end = time.monotonic() + seconds
    while True:
        try:
            with urllib.request.urlopen(address, timeout=10) as answer:
                return answer.read().decode()
        except urllib.error.URLError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def test_it_answers_and_ends_on_ctrl_c(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason=NEEDS_VISER)
    scene, port = scene_file(tmp_path, SCENE), free_port()
    command = [sys.executable, "-c", "from torchlight.cli import main; main()", "view", str(scene), "--port", str(port)]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        [*command, *QUICK], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == f"open http://localhost:{port} in a browser; Ctrl-C ends\n"
        assert "<html" in page(f"http://localhost:{port}")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=180)
    finally:
        process.kill()
    assert (process.returncode, out) == (0, "closed\n")
    assert "Traceback" not in err


def test_controls_change_what_is_shown(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason=NEEDS_VISER)
    scene = scene_file(tmp_path, SCENE)
    shown = view.prepare(arguments.View(results(tmp_path / "r"), scene, resolution=4, no_cache=True))
    server = window.viser_module().ViserServer("localhost", free_port(), verbose=False)
    try:
        controls = window.build(server, shown)
        names = set(server.scene._handle_from_node_name)
        assert {"/plane", "/occluders", "/light", "/light/dome", "/axes"} <= names
        plane, light = (server.scene._handle_from_node_name[name] for name in ("/plane", "/light"))
        before = plane.image.copy()
        controls.degrees.value = 90.0
        assert light.wxyz == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])
        controls.layer.value = "predicted"
        assert not np.array_equal(plane.image, before)
        controls.dome.value = False
        assert light.visible is False
        controls.stops.value = -2.0
        assert plane.image.max() < 255
    finally:
        window.close_window(server)
