"""torchlight convert: what it writes, what it says, and what it refuses in one line."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path
from typing import get_args, get_type_hints

import cv2
import OpenEXR
import pytest
import torch
from torch.testing import assert_close
from workbench import contents
from workbench import torchlight as run

from torchlight.cli import arguments
from torchlight.io.exr import read_exr, write_exr
from torchlight.io.lights import read_light, read_sampled, write_light
from torchlight.io.rgbe import read_hdr, write_hdr
from torchlight.light import formats
from torchlight.light.environment import EnvironmentMap, power, rotate_about_z
from torchlight.light.primaries import PRIMARIES
from torchlight.light.procedural import axis_colours, axis_faces
from torchlight.light.sampled import sphere_power
from torchlight.light_plane import LightPlane


@pytest.fixture
def axes(tmp_path: Path) -> Path:
    path = tmp_path / "axes.exr"
    write_light(path, axis_colours(16, dtype=torch.float32), {"method": "texels"})
    return path


def printed_power(out: str) -> torch.Tensor:
    found = re.search(r"power (\S+) (\S+) (\S+)", out)
    assert found is not None
    return torch.tensor([float(value) for value in found.groups()])


def test_the_names_of_the_options_are_those_of_the_package() -> None:
    assert set(get_args(arguments.Kind)) == set(formats.KINDS)
    assert set(get_args(get_type_hints(arguments.Convert)["primaries"])) == set(PRIMARIES)


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
@pytest.mark.parametrize("kind", formats.KINDS)
def test_every_kind_is_written_and_read_again(axes: Path, kind: str, suffix: str) -> None:
    out = axes.with_name(f"out{suffix}")
    ran = run("convert", axes, "--out", out, "--to", kind)
    assert (ran.code, ran.err) == (0, "")
    expected = power(read_light(axes))
    assert_close(printed_power(ran.out), expected, rtol=1e-4, atol=0)
    back = read_sampled(out, None if suffix == ".exr" else kind)
    assert_close(sphere_power(back).float(), expected, rtol=2e-3 if suffix == ".hdr" else 1e-6, atol=0)
    again = run("convert", out, *([] if suffix == ".exr" else ["--from", kind]), "--out", axes.with_name("back.exr"))
    assert (again.code, again.err) == (0, "")
    assert_close(power(read_light(axes.with_name("back.exr"))), expected, rtol=2e-3, atol=0)


def test_what_an_exr_says_is_kept(axes: Path, tmp_path: Path) -> None:
    assert run("convert", axes, "--out", tmp_path / "cross.exr", "--to", "cross").code == 0
    _, metadata = read_exr(tmp_path / "cross.exr")
    assert metadata == {"convention": "cross", "method": "texels", "nonnegative": True, "units": "relative"}


def test_size_rotation_and_exposure(axes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    ran = run("convert", axes, "--out", out, "--size", 24, "--rotate", -90, "--exposure", 2, "--to", "usd")
    assert (ran.code, ran.err) == (0, "")
    assert "lat-long (usd), 48 x 24 pixels" in ran.out
    back, truth = read_light(out), read_light(axes)
    assert_close(power(back), 2 * power(truth), rtol=1e-6, atol=0)
    assert run("convert", axes, "--out", tmp_path / "same.exr", "--rotate", "z:-90").code == 0
    assert_close(read_light(tmp_path / "same.exr").radiance, rotate_about_z(truth, -90.0).radiance, atol=1e-6, rtol=0)


def test_the_test_map_needs_no_file(tmp_path: Path) -> None:
    assert run("convert", "axes", "--out", tmp_path / "a.exr", "--to", "strip", "--size", 7).code == 0
    assert_close(read_sampled(tmp_path / "a.exr").radiance, axis_faces(7).radiance.float(), atol=0, rtol=0)
    ran = run("convert", "axes", "--out", tmp_path / "b.exr")
    assert "256 x 128 pixels" in ran.out


def test_a_file_called_axes_is_a_file(axes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(axes.parent)
    axes.rename(axes.with_name("axes"))
    assert "32 x 16 pixels" in run("convert", "axes", "--out", "b.exr").out


@pytest.mark.parametrize("primaries", PRIMARIES)
def test_colours_go_to_other_primaries_and_back(axes: Path, tmp_path: Path, primaries: str) -> None:
    out = tmp_path / "out.exr"
    ran = run("convert", axes, "--out", out, "--primaries", primaries)
    assert (ran.code, ran.err) == (0, "")
    with OpenEXR.File(str(out)) as file:
        assert file.header()["chromaticities"] == pytest.approx(PRIMARIES[primaries], abs=1e-6)
    back = run("convert", out, "--out", tmp_path / "back.exr")
    assert back.code == 0
    assert_close(read_light(tmp_path / "back.exr").radiance, read_light(axes).radiance, atol=2e-6, rtol=0)
    if primaries != "rec709":
        assert f"colours of {primaries} primaries are converted to Rec.709" in back.line
        assert primaries in ran.out


def test_a_wide_green_is_negative_in_exr_and_clipped_elsewhere(tmp_path: Path) -> None:
    green = torch.zeros(3, 4, 8)
    green[1] = 1.0
    with OpenEXR.File(
        {"chromaticities": PRIMARIES["acescg"]}, {"RGB": green.permute(1, 2, 0).contiguous().numpy()}
    ) as f:
        f.write(str(tmp_path / "wide.exr"))
    run("convert", tmp_path / "wide.exr", "--out", tmp_path / "a.exr")
    assert read_light(tmp_path / "a.exr").radiance[0, 0, 0].item() == pytest.approx(-0.62179, abs=1e-5)
    ran = run("convert", tmp_path / "wide.exr", "--out", tmp_path / "a.hdr")
    assert ran.code == 0
    # (0.62179 + 0.12897) / (0.62179 + 1.14080 + 0.12897)
    assert f"{tmp_path}/a.hdr: negative radiance is set to 0, 40 % of the flux; .exr keeps it" in ran.err


@pytest.mark.parametrize("suffix", [".hdr", ".png"])
def test_negative_radiance_and_a_near_light_are_said_where_they_are_lost(tmp_path: Path, suffix: str) -> None:
    radiance = torch.ones(3, 8, 16)
    radiance[:, 4:] = -0.25  # half of the sphere
    light = EnvironmentMap(radiance, nonnegative=False, plane=LightPlane(600.0, (10.0, 0.0)))
    write_light(tmp_path / "l.exr", light, {})
    kept = run("convert", tmp_path / "l.exr", "--out", tmp_path / "kept.exr", "--to", "horizontal-cross")
    assert (kept.code, kept.err) == (0, "")
    back = read_sampled(tmp_path / "kept.exr")
    assert (back.nonnegative, back.plane) == (False, light.plane)
    assert back.radiance.min().item() == pytest.approx(-0.25)
    out = tmp_path / f"lost{suffix}"
    ran = run("convert", tmp_path / "l.exr", "--out", out)
    assert ran.code == 0
    assert ran.err.splitlines() == [
        f"torchlight: {out}: negative radiance is set to 0, 20 % of the flux; .exr keeps it",
        f"torchlight: {out}: does not say that the light stands at the height 600 over (10, 0): taken as far away; "
        ".exr keeps it",
    ]
    turned = run("convert", tmp_path / "l.exr", "--out", tmp_path / "t.exr", "--rotate", "x:10")
    assert "turned so, it is taken as far away" in turned.line
    assert read_sampled(tmp_path / "t.exr").plane is None


def test_a_library_is_silent_where_nothing_is_lost(axes: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "torchlight")
    write_light(axes.with_suffix(".hdr"), read_light(axes), {}, convention="cross")
    assert caplog.records == []


def test_a_png_is_a_picture_to_look_at(axes: Path, tmp_path: Path) -> None:
    for kind, shape in (("torchlight", (16, 32)), ("cross", (32, 24)), ("angular", (32, 32))):
        out = tmp_path / f"{kind}.png"
        ran = run("convert", axes, "--out", out, "--to", kind)
        assert (ran.code, ran.err) == (0, "")
        assert "8-bit sRGB of radiance x" in ran.out
        picture = cv2.imread(str(out))
        assert picture is not None
        assert picture.shape[:2] == shape
    assert picture[0, 0].tolist() == [0, 0, 0]  # a caption
    assert picture[16, 16, 1] > 200  # +Y in the middle, green


@pytest.mark.parametrize("kind", ["sh", "irradiance-sh"])
def test_harmonics(axes: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / "sh.json"
    ran = run("convert", axes, "--out", out, "--to", kind, "--degree", 2)
    assert (ran.code, ran.err) == (0, "")
    assert "to degree 2" in ran.out
    content = json.loads(out.read_text())
    assert content["cosine_convolved"] is (kind == "irradiance-sh")
    assert content["metadata"] == {"method": "texels"}
    assert len(content["red"]) == 9
    back = run("convert", out, "--out", tmp_path / "back.exr", "--size", 8)
    assert (back.code, back.err) == (0, "")
    assert_close(power(read_light(tmp_path / "back.exr")), power(read_light(axes)), rtol=1e-5, atol=0)
    assert run("convert", axes, "--out", tmp_path / "default.json").code == 0
    assert json.loads((tmp_path / "default.json").read_text())["degree"] == 8


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--out", "a.tif"], "ends in .exr, .hdr, .png or .json"),
        (["--out", "a.exr", "--to", "sh"], "--to sh: is written as .json"),
        (["--out", "a.json", "--to", "cross"], "--to cross: is written as .exr, .hdr or .png"),
        (["--out", "a.json", "--size", 4], "--degree instead"),
        (["--out", "a.exr", "--degree", 4], "--size instead"),
        (["--out", "a.json", "--degree", 65], "expected 0 to 64"),
        (["--out", "a.exr", "--size", 0], "expected 1 to"),
        (["--out", "a.exr", "--size", 6, "--to", "angular", "--rotate", "north"], "expected degrees about z"),
        (["--out", "a.exr", "--rotate", "1,0,0,0,1,0,0,0,-1"], "without scale, shear or mirror"),
        (["--out", "a.exr", "--exposure", 0], "expected a positive number"),
        (["--out", "a.exr", "--exposure", 1e39], "beyond float32"),
        (["--out", "a.png", "--primaries", "acescg"], "a .png is sRGB"),
        (["--out", "a.exr", "--to", "panorama"], "invalid choice 'panorama'"),
        (["--out", "a.exr", "--from", "angular"], "expected a square picture"),
        (["--out", "a.exr", "--from", "cross"], "cross: expected 3 F x 4 F pixels, got 32 x 16"),
        (["--out", "a.exr", "--to", "usd", "--size", 5], "a quarter turn of 10 columns"),
        (["--out", "axes.exr"], "already there; pass --overwrite"),
        (["--out", "no/a.exr"], "there is no folder"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    axes: Path, monkeypatch: pytest.MonkeyPatch, options: list[object], says: str
) -> None:
    monkeypatch.chdir(axes.parent)
    ran = run("convert", axes.name, *options)
    assert ran.code == 2
    assert says in ran.line
    assert contents(axes.parent) == ["axes.exr"]


def test_bad_lights_are_refused_in_one_line(tmp_path: Path) -> None:
    write_hdr(tmp_path / "odd.hdr", torch.ones(3, 10, 17))
    write_hdr(tmp_path / "photo.hdr", torch.ones(3, 12, 16))
    write_exr(tmp_path / "nan.exr", torch.full((3, 4, 8), torch.nan), {})
    write_exr(tmp_path / "inf.exr", torch.full((3, 4, 8), torch.inf), {})
    write_exr(tmp_path / "strange.exr", torch.ones(3, 4, 8), {"convention": "mercator"})
    write_exr(tmp_path / "cross.exr", torch.ones(3, 8, 6), {})
    (tmp_path / "no.json").write_text("{}")
    cases = {
        "absent.exr": "no such file",
        "odd.hdr": "17 x 10 pixels is no lat-long (2:1)",
        "photo.hdr": "if it is a horizontal cross, name it horizontal-cross",
        "nan.exr": "NaN or infinite radiance",
        "inf.exr": "NaN or infinite radiance",
        "strange.exr": "unknown name 'mercator'",
        "no.json": "no other JSON is light",
    }
    for name, says in cases.items():
        ran = run("convert", tmp_path / name, "--out", tmp_path / "out.exr")
        assert ran.code == 2
        assert name in ran.line
        assert says in ran.line
    ran = run("convert", tmp_path / "cross.exr", "--from", "usd", "--out", tmp_path / "out.exr")
    assert "is no lat-long but a cube cross, whose axes are fixed" in ran.line
    assert run("convert", "axes", "--from", "usd", "--out", tmp_path / "out.exr").code == 2
    assert not (tmp_path / "out.exr").exists()


def test_overwrite(axes: Path) -> None:
    assert run("convert", axes, "--out", axes, "--to", "cross", "--overwrite").code == 0
    assert read_exr(axes)[0].shape == (3, 32, 24)


def test_hdr_in_other_primaries_says_so(axes: Path, tmp_path: Path) -> None:
    assert run("convert", axes, "--out", tmp_path / "a.hdr", "--primaries", "rec2020").code == 0
    assert b"PRIMARIES= 0.708" in (tmp_path / "a.hdr").read_bytes()
    assert_close(read_hdr(tmp_path / "a.hdr"), read_light(axes).radiance, atol=0.02, rtol=0)
