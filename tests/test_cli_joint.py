"""`torchlight joint`: what it writes and prints, and the one line that it answers wrong input with."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from cameras import exif_block, exposure_entries, jpeg_with
from torch import Tensor
from workbench import BLOCK, BOX, LINEAR, RECEIVER, RECTIFIED, Ran, contents, png, scene_file, shadow
from workbench import torchlight as run

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.io.views_file import read_views
from torchlight.light.procedural import sun_and_window
from torchlight.synthetic import block_values, expose, pixel_rays, receiver_image

PAGE = Path(__file__).parent.parent / "docs" / "joint.md"
SECOND = RECTIFIED.replace("[0, 0, 20]", "[0, 0, 70]")
FILES = ["confidence.exr", "fit_1.png", "fit_2.png", "joint.json", "light.exr", "light.hdr", "light.png", "report.html"]
NOISE = 3e-4  # at 1 % these 256 samples determine no texel of 16 x 16 at all, one photograph or two
VIEWS = "photographs:\n  - {scene: one.yaml, photo: one.png}\n  - {scene: two.yaml, photo: two.png}\n"


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def shorten(monkeypatch: pytest.MonkeyPatch, shared: Path) -> None:
    """One cache of small transports, and short curves: what is tested here is the command."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(shared))
    monkeypatch.setattr("torchlight.cli.joint.RESOLUTION", 16)
    monkeypatch.setattr("torchlight.cli.joint.BANDWIDTH_MAX", 5)
    monkeypatch.setattr("torchlight.cli.joint.ROTATIONS", 8)
    monkeypatch.setattr("torchlight.cli.joint.NOISE", NOISE)
    monkeypatch.setattr("torchlight.precomputation.DIRECTIONS_PER_EDGE", 32)


@pytest.fixture(autouse=True)
def quick(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch, shared)


@cache
def turned() -> Tensor:
    """The block turned to 70 degrees, at the exposure of `shadow`."""
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (16, 16))
    rays = pixel_rays(sun_and_window(64))
    exposure = expose(block_values(BLOCK, receiver, rays), torch.ones(receiver.points, dtype=torch.bool))
    return receiver_image(block_values(Block(BLOCK.size, 70.0), receiver, rays) * exposure, receiver).float()


def files(folder: Path, views: str = VIEWS, factor: float = 0.6) -> Path:
    scene_file(folder, name="one.yaml")
    scene_file(folder, SECOND, "two.yaml")
    png(folder / "one.png")
    png(folder / "two.png", turned() * factor)
    (folder / "views.yaml").write_text(views)
    return folder / "views.yaml"


def joint(folder: Path, *options: object, views: str = VIEWS, factor: float = 0.6) -> Ran:
    made = files(folder, views, factor)
    return run("joint", made, "--out", folder / "out", "--method", "texels", "--resolution", 8, *options)


def result(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "out" / "joint.json").read_text())


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, shared: Path) -> tuple[Path, Ran]:
    folder = tmp_path_factory.mktemp("joint")
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, shared)
        return folder, joint(folder)


def test_one_light_and_a_fit_per_photograph(made: tuple[Path, Ran]) -> None:
    folder, ran = made
    assert (ran.code, ran.err) == (0, "")
    assert contents(folder / "out") == FILES
    first, second, *added, last = ran.out.splitlines()
    assert first.startswith(f"{folder / 'one.png'}: exposure 1 (unit), RMS ")
    said = re.fullmatch(r"(.*): exposure (0\.\d+) \+- 0\.\d+ % \(estimated\), RMS \d+\.\d+ of 255", second)
    assert said is not None, second
    assert said[1] == str(folder / "two.png")
    assert float(said[2]) == pytest.approx(0.6, abs=2e-3)
    assert added[0].startswith("one.png alone: harmonics up to B = ")
    assert added[1].startswith("2 photographs together: harmonics up to B = ")
    assert last == f"{folder / 'out'}: the light of 2 photographs"
    for name in FILES:
        if name.endswith(".png"):
            picture = cv2.imread(str(folder / "out" / name))
            assert picture is not None
            assert np.ptp(picture) > 200


def test_confidence_is_of_both_together(made: tuple[Path, Ran]) -> None:
    folder, found = made[0], result(made[0])
    with OpenEXR.File(str(folder / "out/confidence.exr"), separate_channels=True) as file:
        planes, said = (
            {name: one.pixels for name, one in file.channels().items()},
            json.loads(file.header()["torchlight"]),
        )
    assert set(planes) == {"observability", "deviation.R", "deviation.G", "deviation.B"}
    assert (said["fill"], said["method"]) == ("none", "texels")
    assert found["confidence"]["degrees_of_freedom"] > 10
    assert 0 <= found["confidence"]["determined_share"] <= 1
    assert planes["observability"].max() <= 1.0001


def test_the_report_shows_every_photograph_and_needs_nothing_else(made: tuple[Path, Ran]) -> None:
    page = (made[0] / "out/report.html").read_text()
    for name in ("one.png", "two.png"):
        assert f"{name}: what was seen, and what the light explains" in page
        assert f'alt="The photograph {name}"' in page
    assert "the first 2 together" in page
    assert f"{result(made[0])['photographs'][1]['exposure']:.4g} +- " in page
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count("data:image/jpeg") == 2


def test_the_exposure_is_found(made: tuple[Path, Ran]) -> None:
    one, two = result(made[0])["photographs"]
    assert (one["exposure"], one["exposure_deviation"], one["exposure_from"]) == (1.0, 0.0, "unit")
    assert two["exposure"] == pytest.approx(0.6, abs=4 * two["exposure_deviation"])
    assert 0 < two["exposure_deviation"] < 0.005
    assert max(one["rms_255"], two["rms_255"]) < 4  # 8 x 8 texels under a sun
    assert result(made[0])["status"] == ["converged"] * 3


def test_the_second_photograph_adds(made: tuple[Path, Ran]) -> None:
    told = result(made[0])["added"]
    assert told["together"][0] == told["alone"][0]
    before, after = told["together"]
    assert after["degrees_of_freedom"] > max(item["degrees_of_freedom"] for item in told["alone"])
    assert after["determined"] > max(item["determined"] for item in told["alone"])
    for alone in told["alone"]:
        assert all(a <= b for a, b in zip(after["nullity"], alone["nullity"], strict=True))
    assert sum(after["nullity"]) < sum(before["nullity"])


def test_what_is_added_is_what_analyze_says(made: tuple[Path, Ran], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = made
    monkeypatch.setattr("torchlight.cli.analyze.RESOLUTION", 16)
    monkeypatch.setattr("torchlight.report.folder.PICTURE_RAYS", 8)
    monkeypatch.setattr("torchlight.view.FINEST_SAMPLES", 20)
    options = ("--bandwidth-max", 5, "--rotations", 8, "--noise", NOISE)
    scenes = (folder / "one.yaml", folder / "two.yaml")
    assert run("analyze", *scenes, "--out", folder / "analysis", *options).code == 0
    cases = json.loads((folder / "analysis" / "analysis.json").read_text())["cases"]
    told = result(folder)["added"]
    for case, found in zip(cases, (*told["alone"], told["together"][1]), strict=True):
        assert found["nullity"] == case["nullity"]["1e-04"]["mean"]
        assert found["recommended_bandwidth"] == case["recommended_bandwidth"]["1e-04"]
        assert found["degrees_of_freedom"] == pytest.approx(case["degrees_of_freedom"])


def test_a_copy_of_a_photograph_is_no_second_measurement(tmp_path: Path) -> None:
    views = files(tmp_path)
    (tmp_path / "two.png").write_bytes((tmp_path / "one.png").read_bytes())
    ran = run("joint", views, "--out", tmp_path / "out")
    same = f"{tmp_path / 'two.png'}: the same photograph as {tmp_path / 'one.png'}, byte for byte"
    assert (ran.code, same in ran.line) == (2, True)
    assert not (tmp_path / "out").exists()


def test_the_page_shows_what_is_written(made: tuple[Path, Ran]) -> None:
    text = PAGE.read_text()
    for key in (*result(made[0]), *result(made[0])["photographs"][0], *result(made[0])["added"]):
        assert f"`{key}`" in text or f'"{key}"' in text, key
    section = text.split("## What comes out\n")[1].split("\n## ")[0]
    named = set(re.findall(r"^\| `([\w.]+)` \|", section, re.MULTILINE))
    assert named == {*FILES, "refinement.png"}


def test_the_views_file_of_the_page_can_be_read(tmp_path: Path) -> None:
    (shown,) = re.findall(r"^```text\n(photographs:.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "views.yaml").write_text(shown)
    assert {view.exposure for view in read_views(tmp_path / "views.yaml")} == {"exif", "estimate"}


def test_stated_exposures_and_robust(tmp_path: Path) -> None:
    views = VIEWS.replace("one.png}", "one.png, exposure: 2}").replace("two.png}", "two.png, exposure: 1.2}")
    ran = joint(tmp_path, "--robust", views=views)
    assert (ran.code, ran.err) == (0, "")
    one, two = result(tmp_path)["photographs"]
    assert (one["exposure"], two["exposure"], two["exposure_from"]) == (2.0, 1.2, "given")
    assert result(tmp_path)["exposure_unit"] == "as given"


def jpeg(path: Path, image: Tensor, below: int, iso: int | None = 100) -> None:
    codes = (image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()[..., ::-1]
    data = cv2.imencode(".jpg", np.ascontiguousarray(codes), [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    path.write_bytes(jpeg_with(data, exif_block(exposure_entries((1, below), (28, 10), iso))))


EXIF = VIEWS.replace(".png}", ".jpg, exposure: exif}")


def test_exposures_from_exif(tmp_path: Path) -> None:
    jpeg(tmp_path / "one.jpg", shadow(), 60)
    jpeg(tmp_path / "two.jpg", turned() / 2, 120)
    ran = joint(tmp_path, views=EXIF)
    assert (ran.code, ran.err) == (0, "")
    assert [item["exposure"] for item in result(tmp_path)["photographs"]] == [1.0, 0.5]
    assert result(tmp_path)["exposure_unit"] == "EXIF of the first photograph that has it"


def test_one_pose_twice_is_said_to_add_nothing(tmp_path: Path) -> None:
    png(tmp_path / "again.png", shadow() * 0.7)
    ran = joint(tmp_path, views=VIEWS.replace("two.yaml", "one.yaml").replace("two.png", "again.png"))
    assert ran.code == 0
    assert "all photographs show the object in one pose: together they lower the noise and add nothing else" in ran.line
    assert result(tmp_path)["photographs"][1]["exposure"] == pytest.approx(0.7, rel=5e-3)


def test_the_default_is_adaptive(tmp_path: Path) -> None:
    ran = run("joint", files(tmp_path), "--out", tmp_path / "out", "--resolution", 16, "--functions", 60)
    assert (ran.code, ran.err) == (0, "")
    assert contents(tmp_path / "out") == sorted([*FILES, "refinement.png"])
    assert max(result(tmp_path)["functions"]) <= 60


def test_settings_come_from_a_file_as_in_estimate(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("light: {method: texels, resolution: 8}\nsolver: {name: ridge, robust: true}\n")
    ran = run("joint", files(tmp_path), "--out", tmp_path / "a", "--config", tmp_path / "c.yaml", "--robust", "false")
    options = ("--light.method", "texels", "--light.resolution", 8, "--solver.name", "ridge")
    again = run("joint", tmp_path / "views.yaml", "--out", tmp_path / "b", *options)
    assert (ran.code, ran.err, again.code, again.err) == (0, "", 0, "")
    told = json.loads((tmp_path / "a" / "joint.json").read_text())
    assert (told["method"], told["resolution"], told["solver"]) == ("texels", 8, "ridge")
    assert not told["nonnegative"]
    assert told == json.loads((tmp_path / "b" / "joint.json").read_text())


# --- what is refused -----------------------------------------------------------------------------------------------

ONE = "photographs:\n  - {scene: one.yaml, photo: one.png}\n"


@pytest.mark.parametrize(
    ("views", "message"),
    [
        (ONE, "photographs: expected at least two photographs, got 1"),
        ("photographs: one.png\n", "photographs: expected a list of photographs with their scenes"),
        ("photos: []\n", "photos: unknown key; did you mean 'photographs'?"),
        (
            VIEWS.replace("two.png}", "two.png, exposure: 0}"),
            "photographs[1].exposure: expected a number above 0, got 0",
        ),
        (VIEWS.replace("two.png}", "two.png, exposure: -1}"), "expected a number above 0, got -1"),
        (VIEWS.replace("two.png}", "two.png, exposure: EXIF}"), "expected a number above 0, exif or estimate"),
        (VIEWS.replace("two.png", "one.png"), "one.png is listed twice"),
        (VIEWS.replace("two.png", "three.png"), "three.png: no such file"),
        (VIEWS.replace("two.yaml", "three.yaml"), "three.yaml: no such file"),
        (VIEWS.replace("two.png}", "two.png, exposure: exif}"), "two.png: its EXIF records no exposure time"),
        (
            VIEWS.replace("one.png}", "one.png, exposure: 1}").replace("two.png}", "two.png, exposure: exif}"),
            "numbers and 'exif' stand side by side",
        ),
        (ONE + "  - {photo: two.png}\n", "photographs[1].scene: missing; for example 'scene: pose1.yaml'"),
    ],
)
def test_views_files_that_are_wrong(tmp_path: Path, views: str, message: str) -> None:
    ran = joint(tmp_path, views=views)
    assert ran.code == 2
    assert message in ran.line
    assert not (tmp_path / "out").exists()


def spoil(folder: Path, name: str) -> str:
    """Replaces one of the files by what cannot be used and returns what is to be said about it."""
    if name == "unreadable":
        (folder / "two.png").write_bytes(b"no picture")
        return "two.png: "
    if name == "black":
        png(folder / "two.png", torch.zeros(3, 16, 16))
        return "two.png: the photograph is black on the receiver"
    if name == "units":
        scene_file(folder, SECOND.replace("mm", "cm"), "two.yaml")
        return "different units, cm and mm"
    if name == "reference":
        scene_file(folder, SECOND + "reference: smooth\n", "two.yaml")
        return "reference smooth changes its level"
    scene_file(folder, BOX + RECEIVER, "two.yaml")
    return "two.png: "


@pytest.mark.parametrize("setting", ["checks: {skip_near_test: true}", "output: {skip_pictures: true}"])
def test_a_setting_of_single_photographs_is_refused(tmp_path: Path, setting: str) -> None:
    (tmp_path / "c.yaml").write_text(setting)
    ran = run("joint", files(tmp_path), "--out", tmp_path / "out", "--config", tmp_path / "c.yaml")
    assert ran.code == 2
    assert "torchlight joint has no such setting; leave it away" in ran.line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["unreadable", "black", "units", "reference", "encoding"])
def test_files_that_cannot_be_used_stop_all(tmp_path: Path, name: str) -> None:
    assert LINEAR in SECOND
    views = files(tmp_path, VIEWS.replace("two.png}", "two.png, exposure: 1}"))
    message = spoil(tmp_path, name)
    ran = run("joint", views, "--out", tmp_path / "out", "--method", "texels", "--resolution", 8)
    assert ran.code == 2
    assert message in ran.line
    assert not (tmp_path / "out").exists()


def test_what_is_there_is_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    assert "already there; pass --overwrite" in joint(tmp_path).line
    assert "not a joint result, so --overwrite leaves it" in joint(tmp_path, "--overwrite").line
    assert contents(tmp_path / "out") == ["mine.txt"]
