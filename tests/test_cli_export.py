"""`torchlight export`: folders complete or absent, and one line for what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close
from workbench import contents, light
from workbench import torchlight as run

from torchlight.io.exr import read_exr, write_channels, write_exr
from torchlight.io.lights import read_light, write_light
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import axis_colours
from torchlight.light_plane import LightPlane

PROGRAMS = ("blender", "mitsuba", "openexr", "usd", "threejs", "skylibs")
FILES = """lamps.json light.usda light_blender.exr light_blender.py light_mitsuba.exr light_mitsuba.py light_mitsuba.xml
light_openexr.exr light_openexr.py light_skylibs.exr light_skylibs.py light_threejs.exr light_threejs.js
light_usd.exr"""


def test_one_folder_serves_all_programs(tmp_path: Path) -> None:
    ran = run("export", light(tmp_path / "l.exr"), "--to", *PROGRAMS, "--out", tmp_path / "out", "--lamps", 2)
    assert (ran.code, ran.err) == (0, "")
    assert contents(tmp_path / "out") == FILES.split()
    for program in PROGRAMS:
        assert f"{program}: light" in ran.out
    assert "2 lamps taken out of the pictures, 55% of the light on the plane" in ran.out
    lamps = json.loads((tmp_path / "out/lamps.json").read_text())
    assert lamps["lamps_are"] == "taken out of the pictures"
    whole, rest = read_light(tmp_path / "l.exr"), read_light(tmp_path / "out/light_usd.exr")
    assert float(rest.radiance.max()) < 0.1 * float(whole.radiance.max())


def test_the_folder_of_an_estimate_is_a_light_and_its_observability_is_used(tmp_path: Path) -> None:
    folder = tmp_path / "estimate"
    folder.mkdir()
    light(folder / "light.exr")
    maps = torch.stack([torch.full((8, 16), value) for value in (0.8, 0.1, 0.0)])
    write_exr(folder / "observability.exr", maps, {"R": "resolution R_ii"})
    ran = run("export", folder, "--to", "blender", "--out", tmp_path / "out")
    assert ran.code == 0
    assert "still in the pictures; --lamps 3 takes them out" in ran.out
    lamps = json.loads((tmp_path / "out/lamps.json").read_text())
    assert [lamp["confidence"] for lamp in lamps["lamps"]] == [pytest.approx(0.8)] * 3
    assert_close(read_light(tmp_path / "out/light_blender.exr").radiance, read_light(folder / "light.exr").radiance)


def test_the_confidence_of_an_estimate_comes_before_what_was_known_of_its_scene(tmp_path: Path) -> None:
    light(tmp_path / "light.exr")
    write_exr(tmp_path / "observability.exr", torch.zeros(3, 8, 16), {"R": "resolution R_ii"})
    write_channels(tmp_path / "confidence.exr", {"observability": torch.full((8, 16), 0.6)}, {})
    assert run("export", tmp_path, "--to", "usd", "--out", tmp_path / "out").code == 0
    lamps = json.loads((tmp_path / "out/lamps.json").read_text())
    assert [lamp["confidence"] for lamp in lamps["lamps"]] == [pytest.approx(0.6)] * 3
    write_channels(tmp_path / "confidence.exr", {"deviation.R": torch.zeros(8, 16)}, {})
    ran = run("export", tmp_path, "--to", "usd", "--out", tmp_path / "two")
    assert (ran.code, "holds no channel 'observability', only deviation.R" in ran.line) == (2, True)
    (tmp_path / "empty").mkdir()
    ran = run("export", tmp_path, "--to", "usd", "--out", tmp_path / "three", "--observability", tmp_path / "empty")
    assert (ran.code, "holds neither confidence.exr nor observability.exr" in ran.line) == (2, True)


def test_another_convention_and_files_that_say_their_own(tmp_path: Path) -> None:
    own = axis_colours(16, dtype=torch.float32)
    write_light(tmp_path / "own.exr", own, {}, convention="skylibs")
    image, _ = read_exr(tmp_path / "own.exr")
    write_exr(tmp_path / "bare.exr", image, {})
    for source, options in (("own", ()), ("bare", ("--convention", "skylibs"))):
        ran = run("export", tmp_path / f"{source}.exr", "--to", "openexr", "--out", tmp_path / source, *options)
        assert ran.code == 0
        assert_close(read_light(tmp_path / source / "light_openexr.exr").radiance, own.radiance)


def test_what_a_target_cannot_hold_is_said(tmp_path: Path) -> None:
    radiance = torch.ones(3, 16, 32)
    radiance[:, :4] = -0.5
    near = EnvironmentMap(radiance, nonnegative=False, plane=LightPlane(3.0))
    write_light(tmp_path / "l.exr", near, {})
    ran = run("export", tmp_path / "l.exr", "--to", "usd", "openexr", "--out", tmp_path / "out")
    assert ran.code == 0
    assert "no source stands out" in ran.out
    assert "This light stands at the height 3 over (0, 0); here it is taken as far away" in ran.out
    assert "negative radiance was set to 0 for usd: 33.33% of the flux" in ran.out
    assert float(read_light(tmp_path / "out/light_openexr.exr").radiance.min()) == -0.5


def bad(path: Path, image: torch.Tensor) -> Path:
    write_exr(path, image, {})
    return path


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--to", "maya"), "maya"),
        (("--to", "usd", "--convention", "unity"), "unity"),
        (("--to", "usd", "--lamps", "-1"), "--lamps: expected 0 or more"),
        (("--to", "usd", "--lamps", "100"), "expected 0 to 64, got 100"),
        (("--to", "usd", "--strength", "0"), "--strength: expected a positive number"),
        (("--to", "usd", "--observability", "none.exr"), "no such file"),
        ((), "--to"),
    ],
)
def test_wrong_options_are_one_line(tmp_path: Path, options: tuple[str, ...], message: str) -> None:
    ran = run("export", light(tmp_path / "l.exr", 16), "--out", tmp_path / "out", *options)
    assert ran.code == 2
    assert message in ran.line
    assert contents(tmp_path) == ["l.exr"]


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (torch.ones(3, 10, 16), "16 x 10 pixels is no lat-long (2:1)"),
        (torch.full((3, 8, 16), torch.nan), "NaN or infinite radiance"),
        (torch.full((3, 8, 16), torch.inf), "NaN or infinite radiance"),
    ],
)
def test_lights_that_are_none_are_one_line(tmp_path: Path, image: torch.Tensor, message: str) -> None:
    ran = run("export", bad(tmp_path / "l.exr", image), "--to", "blender", "--out", tmp_path / "out")
    assert ran.code == 2
    assert message in ran.line
    assert contents(tmp_path) == ["l.exr"]


def test_a_picture_that_is_no_observability_map_is_refused(tmp_path: Path) -> None:
    source = light(tmp_path / "l.exr", 16)
    ran = run("export", source, "--to", "usd", "--out", tmp_path / "out", "--observability", source)
    assert (ran.code, "not an observability map" in ran.line) == (2, True)


def test_folders_are_replaced_only_if_asked_and_only_if_they_are_exports(tmp_path: Path) -> None:
    source = light(tmp_path / "l.exr", 16)
    arguments = ("export", source, "--to", "usd", "--out", tmp_path / "out")
    assert run(*arguments).code == 0
    assert "already there; pass --overwrite" in run(*arguments).line
    assert run(*arguments, "--overwrite").code == 0
    (tmp_path / "other").mkdir()
    ran = run("export", source, "--to", "usd", "--out", tmp_path / "other", "--overwrite")
    assert "not an export" in ran.line
