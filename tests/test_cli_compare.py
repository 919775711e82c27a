"""`torchlight compare`: numbers that agree with the library, files, and one line for what cannot be compared."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from workbench import BOX, LINEAR, contents, scene_file
from workbench import torchlight as run

from torchlight import metrics
from torchlight.io.exr import write_exr
from torchlight.io.images import read_photo
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.light.environment import rotate_about_z
from torchlight.light.procedural import sun_and_window
from torchlight.light_metrics.radiance import rmse
from torchlight.light_metrics.summary import paired
from torchlight.relighting import relight

SCENE = BOX + "receiver: {size: [4, 4], samples: [8, 8]}\n" + LINEAR
QUICK = ("--sphere-size", 8, "--map-height", 0)


@pytest.fixture(scope="module")
def lights(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sky of 32 rows, and half of it turned by 20 degrees, on 16 rows."""
    folder = tmp_path_factory.mktemp("lights")
    reference, light = folder / "reference.exr", folder / "light.exr"
    write_exr(reference, sun_and_window(32).radiance.float(), {})
    write_exr(light, 0.5 * rotate_about_z(sun_and_window(16), 20.0).radiance.float(), {})
    return light, reference


def compared(*arguments: object) -> dict:
    ran = run("compare", *arguments, *QUICK, "--json")
    assert (ran.code, ran.err) == (0, "")

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    return json.loads(ran.out, parse_constant=refuse)


def test_json_holds_what_the_library_finds(lights: tuple[Path, Path]) -> None:
    found = compared(*lights)
    assert (found["rows"], found["grid_rows"], found["over"]) == ([16, 32], 16, "upper")
    pair = paired(read_light(lights[0]), read_light(lights[1]))
    x, y = (each.radiance.flatten(start_dim=1) for each in (pair.light, pair.reference))
    assert_close(found["radiance"]["rmse"], rmse(x, y, pair.weights).item())
    # the sun is wider than its shift is not: 20 degrees of azimuth at 50 degrees of elevation are 12.8 degrees
    assert found["direction"]["strongest_peak_degrees"] == pytest.approx(12.8, abs=3)  # texels are 5 degrees wide
    assert found["totals"]["irradiance_luminance"] == pytest.approx(-0.5, abs=0.02)  # and 16 rows see a sun askew
    assert set(found["spheres"]) == {"protocol", "mirror", "matte", "diffuse"}
    assert found["scene"] is found["flip"] is None


def test_a_light_against_itself(lights: tuple[Path, Path]) -> None:
    found = compared(lights[1], lights[1], "--over", "sphere")
    assert found["radiance"]["rmse"] == found["radiance"]["colour_degrees"] == found["direction"]["mean_degrees"] == 0
    assert found["radiance"]["si_scale"] == pytest.approx(1)
    assert [found["spheres"][name]["rmse"] for name in ("mirror", "matte", "diffuse")] == [0, 0, 0]


def test_fitted_scales(lights: tuple[Path, Path], tmp_path: Path) -> None:
    tinted = read_light(lights[1]).radiance / torch.tensor([2.0, 4.0, 8.0])[:, None, None]
    write_exr(tmp_path / "tinted.exr", tinted, {})
    found = compared(tmp_path / "tinted.exr", lights[1], "--fit", "channels")
    assert found["scale"] == pytest.approx([2, 4, 8], rel=1e-5)
    assert found["radiance"]["rmse"] == pytest.approx(0, abs=1e-4)
    one = compared(tmp_path / "tinted.exr", lights[1], "--fit", "scale")
    assert one["radiance"]["rmse"] == pytest.approx(one["radiance"]["si_rmse"], rel=1e-9)
    assert one["scale"][0] == one["scale"][2]
    lit = compared(tmp_path / "tinted.exr", lights[1], "--fit", "irradiance")
    assert lit["totals"]["irradiance_luminance"] == pytest.approx(0, abs=1e-9)
    assert lit["scale"][0] == lit["scale"][2] != one["scale"][0]


def test_a_scene_splits_the_error(lights: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    scene = scene_file(tmp_path, SCENE)
    found = compared(*lights, "--scene", scene, "--resolution", 4, "--rays", 4096)["scene"]
    parts = [found[f"{name}_rms"] for name in ("determined", "null", "finer")]
    assert np.hypot.reduce(parts) == pytest.approx(found["rms"], rel=1e-9)
    assert 1 < found["determined_directions"] < found["directions"] == 48
    pair = paired(read_light(lights[0]), read_light(lights[1]))
    relit, wanted = (relight(load_scene(scene), each, 4096) for each in (pair.light, pair.reference))
    used = (wanted.amax(dim=0) > 0).to(relit)  # all but what the block stands on
    assert found["relit_rms_255"] == pytest.approx(metrics.rms_255(relit, wanted, used).item(), rel=0.1)


def test_the_table_and_the_folder(lights: tuple[Path, Path], tmp_path: Path) -> None:
    ran = run("compare", *lights, *QUICK, "--out", tmp_path / "out", "--protocol", "stylelight")
    assert (ran.code, ran.err) == (0, "")
    for word in ("si-RMSE", "strongest source", "stops", "matte", "norm-RMSE", "above the horizon, on 16 x 32 pixels"):
        assert word in ran.out
    assert contents(tmp_path / "out") == ["compare.json", "compare.png"]
    assert read_photo(tmp_path / "out" / "compare.png").pixels.shape[1] > 400
    stored = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert stored["spheres"]["protocol"]["tone"] == {"gamma": 2.4, "percentile": 50.0, "level": 0.5}
    assert f"{stored['radiance']['rmse']:.4g}" in ran.out
    again = run("compare", *lights, *QUICK, "--out", tmp_path / "out")
    assert (again.code, "--overwrite" in again.line) == (2, True)
    assert run("compare", *lights, *QUICK, "--out", tmp_path / "out", "--overwrite").code == 0
    other = run("compare", *lights, *QUICK, "--out", tmp_path, "--overwrite")
    assert "not a comparison" in other.line


def test_single_quirks_are_switched(lights: tuple[Path, Path]) -> None:
    plain = compared(*lights, "--protocol", "stylelight", "--tone", "none", "--per", "value")["spheres"]
    assert (plain["protocol"]["tone"], plain["protocol"]["per"], plain["protocol"]["black"]) == (None, "value", "zero")
    clipped = compared(*lights, "--clip", 1, "--pixels", "image", "--black", "skip", "--view", 0, 0, 1)["spheres"]
    assert clipped["protocol"]["view"] == [0, 0, 1]
    assert clipped["mirror"]["rmse"] < plain["mirror"]["rmse"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--height", 7), "even number of rows"),
        (("--noise", 0), "--noise"),
        (("--resolution", 3), "--resolution"),
        (("--clip", -1), "clip"),
        (("--log-offset", 0), "log offset"),
        (("--scene", "none.yaml"), "none.yaml"),
        (("--view", 0, 0, 0), "direction"),
        (("--reference-convention", "sideways"), "sideways"),
    ],
)
def test_wrong_options_give_one_line(lights: tuple[Path, Path], options: tuple[object, ...], said: str) -> None:
    ran = run("compare", *lights, "--sphere-size", 8, "--map-height", 0, *options)
    assert ran.code == 2
    assert said in ran.line


def test_bad_lights_give_one_line(lights: tuple[Path, Path], tmp_path: Path) -> None:
    write_exr(tmp_path / "wide.exr", torch.ones(3, 8, 20), {})
    bad = torch.ones(3, 8, 16)
    bad[0, 2, 3] = float("nan")
    write_exr(tmp_path / "nan.exr", bad, {})
    for name, said in (("wide.exr", "20 x 8"), ("nan.exr", "NaN"), ("missing.exr", "no such file")):
        ran = run("compare", tmp_path / name, lights[1])
        assert ran.code == 2
        assert (name in ran.line, said in ran.line) == (True, True), ran.line


def test_flip_is_asked_for_in_vain(lights: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    ran = run("compare", *lights, "--flip")
    assert (ran.code, "torchlight[flip]" in ran.line) == (2, True)


def test_black_lights_give_json_without_nan(lights: tuple[Path, Path], tmp_path: Path) -> None:
    write_exr(tmp_path / "black.exr", torch.zeros(3, 8, 16), {})
    found = compared(tmp_path / "black.exr", lights[1])
    assert found["direction"]["strongest_peak_degrees"] is None
    assert found["radiance"]["relative_rmse"] == pytest.approx(1)
    assert compared(lights[1], tmp_path / "black.exr")["radiance"]["relative_rmse"] is None
    assert run("compare", tmp_path / "black.exr", tmp_path / "black.exr", *QUICK, "--out", tmp_path / "o").code == 0


def test_negative_radiance_is_compared(lights: tuple[Path, Path], tmp_path: Path) -> None:
    negative = read_light(lights[1]).radiance - 0.3
    write_exr(tmp_path / "negative.exr", negative, {})
    assert compared(tmp_path / "negative.exr", lights[1])["radiance"]["rmse"] == pytest.approx(0.3, rel=1e-4)


def test_flip_is_added(lights: tuple[Path, Path]) -> None:
    pytest.importorskip("flip_evaluator", reason="needs the extra flip: pip install 'torchlight[flip]'")
    found = compared(*lights, "--flip")["flip"]
    assert set(found) == {"maps", "mirror", "matte", "diffuse"}
    assert all(0 < value < 1 for value in found.values())
