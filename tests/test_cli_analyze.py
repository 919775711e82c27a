"""`torchlight analyze`: what it prints, writes and refuses."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchlight.cli import main
from torchlight.geometry.receiver import sample_centers
from torchlight.io import cache
from torchlight.io.exr import read_exr
from torchlight.io.scene_file import load_scene
from torchlight.report import case, folder

FILES = {
    "analysis.json",
    "nullity.png",
    "spectrum.png",
    "directions.png",
    "singular_values.png",
    "observability.png",
    "observability.exr",
}
BLOCK = """
units: mm
occluders: [{{box: [100, 60, 120], rotation_degrees: [0, 0, {turn}]}}]
receiver: {{size: [400, 400], samples: [10, 10]}}
"""
CAMERA = """
camera:
  image_size: [64, 48]
  K: [[95, 0, 31.5], [0, 95, 23.5], [0, 0, 1]]
  world_to_camera: [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, {height}], [0, 0, 0, 1]]
"""
QUICK = ["--bandwidth-max", "4", "--rotations", "12"]


@pytest.fixture(autouse=True)
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A small transport and small pictures: what is tested here is the command."""
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(folder, "PICTURE_RAYS", 8)
    monkeypatch.setattr("torchlight.view.FINEST_SAMPLES", 20)
    monkeypatch.setattr("torchlight.cli.analyze.RESOLUTION", 16)
    monkeypatch.setattr("torchlight.precomputation.DIRECTIONS_PER_EDGE", 32)


def scene(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def block(folder: Path, name: str = "block", turn: int = 20, more: str = "") -> Path:
    return scene(folder / f"{name}.yaml", BLOCK.format(turn=turn) + more)


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as left:
        main(["analyze", *map(str, arguments)])
    assert isinstance(left.value.code, int)
    return left.value.code


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Returns the one line on standard error of a call that cannot start."""
    assert run(*arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("torchlight: ")
    assert printed.err.count("\n") == 1
    return printed.err


def test_it_prints_three_lines_and_writes_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(block(tmp_path), "--out", out, *QUICK) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["harmonics", "detail", "blind"]
    assert {path.name for path in out.iterdir()} == FILES
    page = (Path(__file__).parent.parent / "docs" / "analysis.md").read_text()
    assert set(re.findall(r"^\| `(\S+\.\w+)` \|", page, re.MULTILINE)) == FILES
    for name in FILES:
        if name.endswith(".png"):
            picture = cv2.imread(str(out / name))
            assert picture is not None
            assert np.ptp(picture) > 200
    result = json.loads((out / "analysis.json").read_text())
    assert result["verdict"] == lines
    assert (result["noise"], result["bandwidth_max"], result["rotations"], result["seed"]) == (0.01, 4, 12, 0)
    (only,) = result["cases"]
    assert only["samples"] == 100
    assert 0 < only["used"] < 100
    assert set(only["nullity"]) == set(only["recommended_bandwidth"]) == {"MATLAB", "1e-06", "1e-04", "1e-03"}
    for curve in (*only["nullity"].values(), *only["nullity_all_samples"].values()):
        assert len(curve["mean"]) == len(curve["deviation"]) == 4
    assert 0 < only["energy_up_to_l_2"] < 1
    assert only["degrees_of_freedom"] > 5
    assert len(only["energy_per_degree"]) == 4
    assert only["scenes"] == [str(tmp_path / "block.yaml")]
    assert len(only["scene_sha256"][0]) == 64


def test_the_map_says_what_its_channels_are(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(block(tmp_path), "--out", out, *QUICK)
    image, metadata = read_exr(out / "observability.exr")
    assert image.shape == (3, 256, 512)
    assert metadata["R"] == "resolution R_ii"
    assert {"G", "B", "layout"} <= set(metadata)
    upper = image[:, :128]
    torch.testing.assert_close(upper[1], (1 - upper[0]).clamp(min=0).sqrt(), rtol=0, atol=1e-3)


def test_the_seed_turns_the_directions_and_nothing_else(tmp_path: Path) -> None:
    path = block(tmp_path)
    found = []
    for seed in (0, 1):
        run(path, "--out", tmp_path / "out", "--overwrite", "--seed", seed, *QUICK)
        found.append(json.loads((tmp_path / "out" / "analysis.json").read_text())["cases"][0])
    assert found[0].pop("nullity") != found[1].pop("nullity")
    for name in ("energy_per_degree", "singular_values", "determined", "used"):
        assert found[0][name] == found[1][name]


def test_several_scenes_are_also_taken_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    first, second = block(tmp_path, "first", 0), block(tmp_path, "second", 60)
    assert run(first, second, "--out", out, *QUICK) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[::4] == ["first", "second", "all together", lines[-1]]
    assert lines[-1].startswith("together: +")
    result = json.loads((out / "analysis.json").read_text())
    one, two, both = result["cases"]
    assert both["name"] == "all together"
    assert both["used"] == one["used"] + two["used"]
    assert both["degrees_of_freedom"] > max(one["degrees_of_freedom"], two["degrees_of_freedom"])
    assert both["determined"] >= max(one["determined"], two["determined"])
    for k in range(4):
        more = both["nullity"]["1e-04"]["mean"][k]
        assert more <= min(one["nullity"]["1e-04"]["mean"][k], two["nullity"]["1e-04"]["mean"][k])
    assert result["verdict"] == both["verdict"]


def test_hidden_samples_are_left_out(tmp_path: Path) -> None:
    """What the camera cannot see, and what the mask forbids, raises nullity at every absolute tolerance."""
    path = block(tmp_path, more=CAMERA.format(height=900))
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[:, :32] = 255
    cv2.imwrite(str(tmp_path / "half.png"), mask)
    half = block(tmp_path, "half", more=CAMERA.format(height=900) + "mask: half.png\n")
    results = []
    for scene_file in (path, half):
        run(scene_file, "--out", tmp_path / "out", "--overwrite", *QUICK)
        results.append(json.loads((tmp_path / "out" / "analysis.json").read_text())["cases"][0])
    whole, part = results
    assert part["used"] < whole["used"]
    for tolerance in ("1e-06", "1e-04", "1e-03"):
        ideal = whole["nullity_all_samples"][tolerance]["mean"]
        for k in range(4):
            assert part["nullity"][tolerance]["mean"][k] >= whole["nullity"][tolerance]["mean"][k] >= ideal[k]
    assert part["nullity"]["1e-04"]["mean"][3] > whole["nullity"]["1e-04"]["mean"][3]


# --- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bandwidth-max", "0"], "--bandwidth-max: bandwidth: expected 1 to 32, got 0"),
        (["--bandwidth-max", "33"], "expected 1 to 32, got 33"),
        (["--noise", "0"], "--noise: expected a positive share"),
        (["--noise", "nan"], "--noise: expected a positive share"),
        (["--rotations", "0"], "rotations: expected 1 to 10,000, got 0"),
    ],
)
def test_options_out_of_range(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert message in refused(capsys, block(tmp_path), "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_an_empty_receiver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = scene(tmp_path / "a.yaml", BLOCK.format(turn=0).replace("[10, 10]", "[0, 10]"))
    assert "receiver.samples: expected two positive integers" in refused(capsys, path, "--out", tmp_path / "out")


def test_samples_that_are_all_hidden(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The camera looks at the plane through a plate; and a slab that lies on all of the plane."""
    plate = (
        "occluders: [{box: [900, 900, 10], translation: [0, 0, 200]}]\nreceiver: {size: [400, 400], samples: [8, 8]}"
    )
    above = scene(tmp_path / "above.yaml", plate + CAMERA.format(height=900))
    assert "the camera sees no sample" in refused(capsys, above, "--out", tmp_path / "out")
    slab = plate.replace(", translation: [0, 0, 200]", "")
    covered = scene(tmp_path / "covered.yaml", slab)
    message = refused(capsys, covered, "--out", tmp_path / "out")
    assert f"{covered}: " in message
    assert "no sample of the receiver is usable" in message


def test_samples_that_no_light_reaches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bell of four walls and a roof over the receiver: nothing stands on the samples, and it is dark."""
    walls = [f"{{box: [10, 900, 300], translation: [{x}, 0, 0]}}" for x in (-300, 300)]
    walls += [f"{{box: [900, 10, 300], translation: [0, {y}, 0]}}" for y in (-300, 300)]
    roof = "{box: [900, 900, 10], translation: [0, 0, 299]}"
    text = f"occluders: [{', '.join([*walls, roof])}]\nreceiver: {{size: [400, 400], samples: [6, 6]}}"
    message = refused(capsys, scene(tmp_path / "dark.yaml", text), "--out", tmp_path / "out")
    assert "no light reaches any sample" in message


def test_a_mask_that_leaves_nothing_the_camera_sees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[0, 0] = 255
    cv2.imwrite(str(tmp_path / "corner.png"), mask)
    path = block(tmp_path, more=CAMERA.format(height=900) + "mask: corner.png\n")
    assert "left by the mask" in refused(capsys, path, "--out", tmp_path / "out")


def test_scenes_of_one_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "other").mkdir()
    first, second = block(tmp_path), block(tmp_path / "other")
    assert "several scenes are called block" in refused(capsys, first, second, "--out", tmp_path / "out")


def test_what_is_there_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious.txt").write_text("x")
    path = block(tmp_path)
    assert "already there" in refused(capsys, path, "--out", out)
    assert "not an analysis" in refused(capsys, path, "--out", out, "--overwrite")
    assert [item.name for item in out.iterdir()] == ["precious.txt"]


def test_used_samples_agree_with_a_mask_s_half(tmp_path: Path) -> None:
    """The mask's left half keeps the samples with x < 0, and none of which a pixel is shared with the other half."""
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[:, :32] = 255
    cv2.imwrite(str(tmp_path / "half.png"), mask)
    found = load_scene(block(tmp_path, more=CAMERA.format(height=900) + "mask: half.png\n"))
    used = case.used_samples(found)
    x = sample_centers(found.receiver)[:, 0]
    assert bool(used.any())
    assert x[used].max() < 0
    assert math.isclose(x[used].max().item(), -60.0)
