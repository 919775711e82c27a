"""`torchlight estimate --method adaptive`, from a scene file and photographs to result folders."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
import torch
from safetensors.torch import load_file
from torch.testing import assert_close
from workbench import SUN, degrees_between, png, scene_file

from torchlight import AdaptiveHaar
from torchlight.cli import main
from torchlight.errors import ConfigError
from torchlight.inversion.quadtree import quadtree
from torchlight.inversion.refinement import Fate
from torchlight.io.cache import entries
from torchlight.io.images import read_photo
from torchlight.io.scene_file import load_scene
from torchlight.light.bases import HaarCubemap
from torchlight.observing import linearize
from torchlight.pipeline import estimate
from torchlight.precomputation import precompute

SCENE = """
occluders: [{box: [100, 60, 120]}]
receiver: {size: [400, 300], samples: [24, 18]}
photo: {encoding: linear}
"""

OPTIONS = ("--method", "adaptive", "--resolution", "4", "--functions", "21", "--device", "cpu")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, two photographs of it under lamps of one texel each, and what `--method adaptive` made of them."""
    folder = tmp_path_factory.mktemp("adaptive")
    (folder / "scene.yaml").write_text(SCENE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHLIGHT_CACHE", str(folder / "cache"))
        transfer = precompute(load_scene(folder / "scene.yaml"), 4)
        for number, texel in enumerate((35, 9)):
            light = torch.full((3, 48), 0.2).index_fill(1, torch.tensor([texel]), 9.0)
            light[2] *= 0.5
            values = (light @ transfer.transport.T).reshape(3, 18, 24).flip(1)
            levels = (values / values.max() * 250).round().byte().permute(1, 2, 0).numpy()
            cv2.imwrite(str(folder / f"{number}.png"), levels[..., ::-1].copy())
        photos = [str(folder / f"{number}.png") for number in range(2)]
        call(["estimate", str(folder / "scene.yaml"), *photos, "--out", str(folder / "out"), *OPTIONS], 0)
    return folder


def call(words: list[str], code: int) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert (ended.value.code or 0) == code


@pytest.mark.parametrize("number", [0, 1])
def test_results_say_how_many_functions(folder: Path, number: int) -> None:
    result = json.loads((folder / "out" / str(number) / "result.json").read_text())
    stored = load_file(folder / "out" / str(number) / "estimate.safetensors")
    assert result["method"] == "adaptive"
    assert result["status"] == ["converged"] * 3
    assert result["coefficients"] == 48
    assert result["functions"] == stored["kept"].sum(dim=-1).tolist()
    assert all(9 < count <= 21 for count in result["functions"])
    assert all(count >= 9 for count in result["regions"])
    assert stored["fate"].shape == (3, 13)
    assert (stored["coefficients"][~stored["kept"]] == 0).all()
    assert result["nonnegative"] is True
    assert result["rms_255"] < 1.0
    assert result["fates"] is not None
    assert (folder / "out" / str(number) / "refinement.png").is_file()


def test_the_command_line_does_what_python_does(folder: Path) -> None:
    scene = load_scene(folder / "scene.yaml")
    method = AdaptiveHaar(4, 21, noise=0.0016)
    photo = linearize(read_photo(folder / "0.png"), scene)
    transfer = precompute(scene, 4, use_cache=False)
    found = estimate(photo, scene, method.basis, method, transfer)
    stored = load_file(folder / "out" / "0" / "estimate.safetensors")
    assert_close(found.solution.coefficients, stored["coefficients"], rtol=1e-5, atol=1e-5)
    assert found.refinement is not None
    assert torch.equal(found.refinement.kept, stored["kept"])


def test_the_rule_of_the_paper_is_an_option(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(folder / "cache"))
    words = ["estimate", str(folder / "scene.yaml"), str(folder / "0.png"), "--out", str(tmp_path / "out")]
    call([*words, *OPTIONS, "--rule", "paper"], 0)
    stored = load_file(tmp_path / "out" / "0" / "estimate.safetensors")
    assert not torch.equal(stored["kept"], load_file(folder / "out" / "0" / "estimate.safetensors")["kept"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--solver", "ridge"), "--method adaptive has a solver of its own"),
        (("--functions", "5"), "at least 9"),
        (("--noise", "0"), "noise"),
        (("--resolution", "1024"), "from 2 to 512"),
        (("--resolution", "32", "--rule", "paper"), "at most 16, got 32"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], words: str
) -> None:
    call(["estimate", str(folder / "scene.yaml"), str(folder / "0.png"), "--out", str(tmp_path), *OPTIONS, *options], 2)
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_another_basis_is_refused(folder: Path) -> None:
    scene = load_scene(folder / "scene.yaml")
    with pytest.raises(ConfigError, match="leave the basis away"):
        estimate(torch.ones(3, 18, 24), scene, HaarCubemap(8), AdaptiveHaar(4), precompute(scene, 8, use_cache=False))


def test_it_is_what_everyone_gets_who_names_no_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 450 functions at 128 texels, for a sun; the same from the command line and from Python."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    file, photo = scene_file(tmp_path), png(tmp_path / "sun.png")
    call(["estimate", str(file), str(photo), "--out", str(tmp_path / "out"), "--device", "cpu"], 0)
    result = json.loads((tmp_path / "out/sun/result.json").read_text())
    assert (result["method"], result["resolution"], result["coefficients"]) == ("adaptive", 128, 3 * 128**2)
    assert result["status"] == ["converged"] * 3
    assert result["nonnegative"] is True
    assert all(9 < count <= 450 for count in result["functions"])
    assert result["rms_255"] < 1.0
    assert degrees_between(result["peak_direction"], SUN) < 3
    stored, tree = load_file(tmp_path / "out/sun/estimate.safetensors"), quadtree(128)
    divided = tree.level[tree.supports][(stored["fate"] == Fate.RESOLVED).any(dim=0)]
    assert (divided >= 4).any()  # finer than any texel of the dense transport
    scene = load_scene(file)
    found = estimate(linearize(read_photo(photo), scene), scene, solver=AdaptiveHaar())
    assert found.refinement is not None
    assert found.noise is not None
    assert 0.4 / 255 <= found.noise.item() == pytest.approx(result["noise"])
    assert torch.equal(found.refinement.kept, stored["kept"])
    assert_close(found.solution.coefficients, stored["coefficients"], rtol=1e-4, atol=1e-4)


def test_the_second_call_finds_the_dense_transport_in_the_cache(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    words = ["estimate", str(folder / "scene.yaml"), str(folder / "0.png"), "--resolution", "32", "--device", "cpu"]
    call([*words, "--out", str(tmp_path / "one")], 0)
    assert len(entries()) == 1
    monkeypatch.setattr("torchlight.precomputation.transport", lambda *arguments: pytest.fail("cast again"))
    call([*words, "--out", str(tmp_path / "two")], 0)
    one, two = (load_file(tmp_path / name / "0" / "estimate.safetensors")["coefficients"] for name in ("one", "two"))
    assert torch.equal(one, two)
