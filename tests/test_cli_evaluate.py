"""`torchlight evaluate`: how well a light explains a photograph."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch.testing import assert_close
from workbench import RECTIFIED, exr, light, png, scene_file, shadow
from workbench import torchlight as run

from torchlight.io.exr import write_exr
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.metrics import rms_255
from torchlight.relighting import relight


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def one_cache(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most tests share a few transports, so that rays are cast once."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(shared))


def evaluate(scene: Path, photo: Path, source: Path, *options: object) -> dict:
    ran = run("evaluate", scene, photo, source, *options)
    assert (ran.code, ran.err) == (0, "")

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    return json.loads(ran.out, parse_constant=refuse)


def test_what_is_printed(tmp_path: Path) -> None:
    scene, photo, source = scene_file(tmp_path), exr(tmp_path / "p.exr", 2 * shadow()), light(tmp_path / "l.exr")
    found = evaluate(scene, photo, source)
    assert set(found) == {"rms_255", "rms_relative", "visible", "points", "visible_share"}
    assert found["points"] == 256
    assert found["visible_share"] == found["visible"] / 256
    predicted = relight(load_scene(scene), read_light(source)).reshape(3, 16, 16).flip(1)
    observed = 2 * shadow()
    free = observed.amin(dim=0) > 0
    mean = (predicted - observed)[:, free].square().mean().sqrt() / observed[:, free].square().mean().sqrt()
    assert_close(found["rms_relative"], mean.item(), rtol=0.05, atol=0)  # `free` is not exactly what is visible


def test_the_true_light_explains_its_own_shadow_up_to_the_exposure(tmp_path: Path) -> None:
    """The photograph comes from the block's closed form; only the exposure is unknown."""
    found = evaluate(scene_file(tmp_path), exr(tmp_path / "p.exr"), light(tmp_path / "l.exr"), "--fit-scale")
    assert found["rms_255"] < 0.3
    assert found["scale"] == pytest.approx([found["scale"][0]] * 3, rel=1e-3)


def test_fit_scale_finds_the_factor_of_each_channel(tmp_path: Path) -> None:
    factors = torch.tensor([2.0, 0.5, 3.0])
    scene, source = scene_file(tmp_path), light(tmp_path / "l.exr")
    options = ("--fit-scale", "--rays", 4096)
    plain = evaluate(scene, exr(tmp_path / "p.exr"), source, *options)
    scaled = evaluate(scene, exr(tmp_path / "q.exr", shadow() * factors[:, None, None]), source, *options)
    ratio = torch.tensor(scaled["scale"]) / torch.tensor(plain["scale"])
    assert_close(ratio, factors, rtol=1e-4, atol=0)
    assert "scale" not in evaluate(scene, exr(tmp_path / "r.exr"), source, "--rays", 64)


def test_a_black_light_gives_json_without_nan(tmp_path: Path) -> None:
    write_exr(tmp_path / "black.exr", torch.zeros(3, 8, 16), {})
    scene, photo = scene_file(tmp_path), exr(tmp_path / "p.exr")
    assert_close(evaluate(scene, photo, tmp_path / "black.exr")["rms_relative"], 1.0)
    found = evaluate(scene, photo, tmp_path / "black.exr", "--fit-scale")
    assert found["scale"] == [None] * 3
    assert found["rms_255"] is None


METHODS = [
    ("--method", "texels"),
    ("--method", "haar"),
    ("--method", "sh"),
    ("--method", "sh", "--degree", 2, "--solver", "ridge"),
]


@pytest.mark.parametrize("options", METHODS)
def test_the_written_light_explains_the_photograph_as_the_coefficients_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...]
) -> None:
    relit: list[torch.Tensor] = []
    monkeypatch.setattr("torchlight.cli.evaluate.relight", lambda *given: relit.append(relight(*given)) or relit[0])
    scene = scene_file(tmp_path, RECTIFIED.replace("[16, 16]", "[24, 24]"))
    photo = exr(tmp_path / "p.exr", shadow(24))
    assert run("estimate", scene, photo, "--out", tmp_path / "out", *options).code == 0
    found = evaluate(scene, photo, tmp_path / "out/p/light.exr")
    result = json.loads((tmp_path / "out/p/result.json").read_text())
    assert abs(found["rms_255"] - result["rms_255"]) <= 0.1
    assert (found["visible"], found["points"]) == (result["visible"], result["points"])
    stored = load_file(tmp_path / "out/p/estimate.safetensors")
    assert rms_255(relit[0], stored["predicted"], stored["weights"]).item() <= 0.1


@pytest.mark.parametrize(
    ("text", "photo", "options", "says"),
    [
        (RECTIFIED.replace("photo: {encoding: linear}\n", ""), "p.png", (), "photo.encoding"),
        (RECTIFIED, "none.png", (), "none.png"),
        (RECTIFIED, "black.png", (), "black"),
        (RECTIFIED, "p.png", ("--rays", 0), "rays"),
    ],
)
def test_bad_requests(tmp_path: Path, text: str, photo: str, options: tuple[object, ...], says: str) -> None:
    png(tmp_path / "p.png")
    exr(tmp_path / "nan.exr", torch.full((3, 16, 16), math.nan))
    png(tmp_path / "black.png", torch.zeros(3, 16, 16))
    ran = run("evaluate", scene_file(tmp_path, text), tmp_path / photo, light(tmp_path / "l.exr", 8), *options)
    assert ran.code == 2
    assert says in ran.line
    assert ran.out == ""
