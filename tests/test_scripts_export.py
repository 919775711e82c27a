"""The check of exports: its measure finds turns that are known, and the programs that are installed agree."""

from __future__ import annotations

import math
import os
import shutil
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from torchlight.light.environment import EnvironmentMap
from torchlight.light.lamps import Lamp
from torchlight.light.procedural import axis_colours, sun_and_window

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
measure, exports, programs, setting, check = (
    import_module(name)
    for name in ("exported.measure", "exported.exports", "exported.programs", "exported.setting", "export_check")
)
SAMPLES = 32
PIXEL = math.pi / 256


@cache
def light() -> EnvironmentMap:
    """Returns colours that tell the axes apart, and a sun, so that shadows are sharp."""
    map_ = axis_colours(64, dtype=torch.float32)
    sun = (sun_and_window(64, dtype=torch.float32).radiance - 12).clamp(min=0)
    return EnvironmentMap(map_.radiance * 0.4 + sun)


@pytest.fixture(scope="module")
def item(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "RAYS", 2048)
        patch.setattr(measure, "SLOPE_RAYS", 2048)
        return exports.one(tmp_path_factory.mktemp("export"), "sun", light(), 1, measure.under_light(light()))


def python_with(module: str, program: str) -> str:
    """Returns this Python, or that of TORCHLIGHT_PROGRAM, if it has a module; else skips."""
    python = os.environ.get(f"TORCHLIGHT_{program.upper()}", sys.executable)
    try:
        programs.require(python, module)
    except programs.AbsentError as absent:
        pytest.skip(f"{absent}, by TORCHLIGHT_{program.upper()}")
    return python


def test_the_measure_finds_a_known_turn_and_gain(item: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "FINE_ROWS", 256)
    own = item.rendering.values
    same = measure.agreement(own, item.rendering)
    assert (same.degrees, same.gain, same.rms_percent) == pytest.approx((0, 0, 0), abs=1e-6)
    moved = measure.relight(measure.SCENE, measure.turned(light(), 2, 2 * PIXEL), 4096).double()
    found = measure.agreement(1.03 * moved, item.rendering)
    assert found.degrees == pytest.approx(math.degrees(2 * PIXEL), abs=0.15)
    assert found.gain == pytest.approx(0.03, abs=0.01)


def shadow(lamp: Lamp) -> Tensor:
    return measure.under_lamp(lamp).values


def test_the_measure_finds_the_turn_of_a_lamp() -> None:
    rendering = measure.under_lamp(Lamp((0.6, 0.0, 0.8), 0.01, (1.0, 1.0, 1.0), 1.0))
    turned = Lamp((0.6 * 0.99995, 0.6 * 0.01, 0.8), 0.01, (1.0, 1.0, 1.0), 1.0)  # 0.01 rad of azimuth
    found = measure.agreement(shadow(turned), rendering)
    assert found.degrees == pytest.approx(0.573 * 0.6, abs=0.02)
    assert found.gain < 0.002


def test_pictures_of_the_page_are_right_way_up() -> None:
    values = torch.arange(12.0).reshape(2, 2, 3)  # lowest row first
    picture = programs.square(values.flatten().tolist(), 2)
    assert picture[:, 0, 0].tolist() == [6, 7, 8]


def test_a_program_that_is_absent_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with check.said_if_absent("blender"):
        programs.render("blender", "no-such-python", {}, tmp_path)
    assert "blender: left out: no-such-python has no bpy" in capsys.readouterr().out
    with check.said_if_absent("threejs"):
        programs.render_in_browser("no-such-browser", tmp_path, {})
    assert "threejs: left out: no browser no-such-browser" in capsys.readouterr().out


# --- the programs --------------------------------------------------------------------------------------------------


def agrees(item: Any, program: str, where: Any) -> None:
    told = setting.job(item.folder, exports.shots(item, program), SAMPLES)
    check.rendered(program, told, where, item.folder)
    for row in check.compared(item, program):
        assert row.degrees < 1.0, row
        assert row.irradiance_percent < 2.0, row


def test_blender_agrees(item: Any) -> None:
    agrees(item, "blender", check.Programs(blender=python_with("bpy", "blender")))


def test_mitsuba_agrees(item: Any) -> None:
    agrees(item, "mitsuba", check.Programs(mitsuba=python_with("mitsuba", "mitsuba")))


def test_threejs_agrees(item: Any, tmp_path: Path) -> None:
    three = Path(os.environ.get("TORCHLIGHT_THREE", "node_modules/three"))
    if shutil.which("chromium") is None or not three.is_dir():
        pytest.skip("needs chromium, and three.js in the folder that TORCHLIGHT_THREE names (npm install three)")
    # without lamps: three.js gives them no size, which a fit takes for a turn where the sun is 5 degrees wide
    agrees(exports.one(tmp_path, "picture", light(), 0, item.rendering), "threejs", check.Programs(three=three))


def test_usd_core_agrees(item: Any, tmp_path: Path) -> None:
    found = exports.usd_agreement(item, python_with("pxr", "usd"), tmp_path)
    assert (found["up"], found["format"], found["lamps"]) == ("Z", "latlong", 1)
    assert found["directions_that_find_their_pixel"] == "500 of 500"
    assert found["lamps_off_by_at_most"] < 1e-5


def test_skylibs_agrees(item: Any, tmp_path: Path) -> None:
    found = exports.skylibs_agreement(item, python_with("envmap", "skylibs"), tmp_path)
    assert found["by_direction_off_by_at_most"] == 0
    assert found["by_pixel_off_by_at_most"] == 0
