"""What other programs are handed: texts that parse and say what they should, pictures in the right axes.

The programs themselves read the files in test_scripts_export.py, where they are installed.
"""

from __future__ import annotations

import ast
import importlib.util
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.cli.export import TARGETS
from torchlight.export.folder import write_export
from torchlight.export.handover import Handover, near_line
from torchlight.export.lamps_file import lamps_content
from torchlight.export.mitsuba import interpolated, mitsuba
from torchlight.export.usd import frame, usd
from torchlight.light.directions import to_y_up
from torchlight.light.environment import EnvironmentMap, irradiance, radiance_at
from torchlight.light.lamps import Lamp, extract_lamps
from torchlight.light.procedural import axis_colours, sun_and_window
from torchlight.light_plane import LightPlane

SUNNY = sun_and_window(64, dtype=torch.float32)
LAMPS, REST = extract_lamps(SUNNY, 3)


def some_directions() -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(200, 3, generator=generator, dtype=torch.float64), dim=-1)


def handed(target: str, strength: float = 1.0) -> Handover:
    return TARGETS[target](REST, LAMPS, strength)


def constants(text: str) -> dict[str, Any]:
    """Returns the literals that a Python text gives names to."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return found


def pictures(target: str, light: EnvironmentMap) -> Tensor:
    (picture,) = TARGETS[target](light, (), 1.0).pictures.values()
    return picture.pixels


@pytest.mark.parametrize("target", ["blender", "mitsuba", "openexr", "skylibs"])
def test_python_texts_hold_the_lamps(target: str) -> None:
    text = next(text for name, text in handed(target, 2.5).texts.items() if name.endswith(".py"))
    values = constants(text)
    assert values["STRENGTH"] == 2.5
    assert len(values["LAMPS"]) == len(LAMPS)
    for (direction, facing, diameter, *_), lamp in zip(values["LAMPS"], LAMPS, strict=True):
        assert direction == pytest.approx(lamp.direction, abs=1e-6)
        assert facing == pytest.approx(lamp.irradiance, rel=1e-6)
        assert diameter == pytest.approx(2 * math.degrees(lamp.radius), rel=1e-6)
    assert constants(next(iter(TARGETS[target](SUNNY, (), 1.0).texts.values())))["LAMPS"] == ()


@pytest.mark.parametrize("target", list(TARGETS))
def test_every_text_names_its_picture_and_says_axes_units_and_lamps(target: str) -> None:
    handover = handed(target)
    for text in handover.texts.values():
        assert set(re.findall(r"light_\w+\.exr", text)) == set(handover.pictures)
        assert "right-handed, Z up, the receiver at z = 0" in text
        assert "Radiance is linear, Rec.709 primaries, relative" in text
        assert "What 3 lamps give is no longer in the picture" in text
        assert "no longer in the picture" not in next(iter(TARGETS[target](SUNNY, (), 1.0).texts.values()))


@pytest.mark.parametrize("target", list(TARGETS))
def test_every_text_says_that_a_near_light_is_taken_as_far(target: str) -> None:
    near = replace(SUNNY, plane=LightPlane(500.0, (10.0, 0.0)))
    for text in TARGETS[target](near, (), 1.0).texts.values():
        assert near_line(near) in text
        assert "at the height 500 over (10, 0)" in text
    assert near_line(SUNNY) == ""


@pytest.mark.parametrize("target", list(TARGETS))
def test_renderers_get_no_negative_radiance_the_others_do(target: str) -> None:
    light = replace(SUNNY, radiance=SUNNY.radiance - 0.3, nonnegative=False)
    lowest = float(pictures(target, light).min())
    assert lowest == (pytest.approx(-0.23) if target in ("openexr", "skylibs") else 0.0)


def test_pictures_look_where_each_program_does() -> None:
    light = axis_colours(32)
    directions = some_directions()
    expected = radiance_at(light, directions)
    x, y, z = to_y_up(directions).T
    u = {
        "blender": 0.5 - torch.atan2(directions[:, 1], directions[:, 0]) / (2 * math.pi),
        "threejs": torch.atan2(z, x) / (2 * math.pi) + 0.5,  # its equirectUv
        "usd": 0.5 - torch.atan2(x, z) / (2 * math.pi),
        "openexr": 0.5 - torch.atan2(x, z) / (2 * math.pi),
        "skylibs": (1 + torch.atan2(x, -z) / math.pi) / 2,  # its world2latlong
    }
    row = (torch.acos(y) / math.pi * 32).long()
    for target, across in u.items():
        found = pictures(target, light)[:, row, (across * 64).long() % 64]
        assert_close(found, expected, msg=target)


def test_only_pictures_of_openexr_and_usd_are_marked_as_such() -> None:
    marked = [t for t in TARGETS if next(iter(handed(t).pictures.values())).openexr_envmap]
    assert marked == ["openexr", "usd"]


# --- Mitsuba -------------------------------------------------------------------------------------------------------


def interpolate(image: Tensor, directions: Tensor) -> Tensor:
    """Returns a picture at directions as Mitsuba interpolates it: rows at pi r / (H - 1), columns at halves."""
    x, y, z = to_y_up(directions).T
    rows, columns = image.shape[1:]
    row = torch.acos(y.clamp(-1, 1)) / math.pi * (rows - 1)
    column = (0.5 - torch.atan2(x, z) / (2 * math.pi)) * columns - 0.5
    top, left = row.floor().long().clamp(0, rows - 2), column.floor().long()
    down, right = row - top, column - left
    corners = [image[:, top + i, (left + j) % columns] for i in (0, 1) for j in (0, 1)]
    weights = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    return sum((c * w for c, w in zip(corners, weights, strict=True)), torch.zeros_like(corners[0]))


def test_mitsuba_interpolates_the_picture_to_the_light() -> None:
    image = interpolated(axis_colours(64))
    assert image.shape == (3, 129, 256)
    middle = torch.tensor([[0.3, 0.1, 0.9], [0.9, -0.2, 0.3], [-0.2, 0.9, -0.3], [-0.8, -0.3, 0.1]]).double()
    middle = torch.nn.functional.normalize(middle, dim=-1)
    assert_close(interpolate(image, middle), radiance_at(axis_colours(64), middle), rtol=0.02, atol=0)


def speckled() -> EnvironmentMap:
    return EnvironmentMap(torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(2)).double() ** 8)


@pytest.mark.parametrize("light", [SUNNY, axis_colours(32), speckled()])
def test_its_integral_is_that_of_the_light(light: EnvironmentMap) -> None:
    n = 240
    theta = (torch.arange(n, dtype=torch.float64) + 0.5) * (math.pi / 2 / n)
    phi = (torch.arange(4 * n, dtype=torch.float64) + 0.5) * (math.pi / 2 / n)
    sine = theta.sin()[:, None]
    directions = torch.stack(
        [sine * phi.cos(), sine * phi.sin(), theta.cos()[:, None].expand(-1, len(phi))], dim=-1
    ).reshape(-1, 3)
    weights = (theta.sin() * theta.cos()).repeat_interleave(4 * n) * (math.pi / 2 / n) ** 2
    found = (interpolate(interpolated(light).double(), directions) * weights).sum(dim=-1)
    assert_close(found, irradiance(light).double(), rtol=3e-3, atol=0)  # ramps of 16 rows


def test_mitsubas_xml_holds_the_same_as_its_module() -> None:
    handover = mitsuba(REST, LAMPS, 2.0)
    root = ET.fromstring(handover.texts["light_mitsuba.xml"])
    lamps = constants(handover.texts["light_mitsuba.py"])["LAMPS"]
    shapes = root.findall("shape")
    assert len(shapes) == len(lamps)
    for shape, (direction, facing, diameter, behind) in zip(shapes, lamps, strict=True):
        look = shape.find("transform/lookat")
        radiance, size = shape.find("emitter/rgb"), shape.find("transform/scale")
        assert look is not None
        assert radiance is not None
        assert size is not None
        origin = [float(value) for value in look.attrib["origin"].split(",")]
        assert origin == pytest.approx([1000 * value for value in direction], rel=1e-5)
        angle = math.radians(diameter / 2)
        assert float(size.attrib["x"]) == pytest.approx(1000 * math.tan(angle), rel=1e-5)
        expected = [2 * (e / (math.pi * math.sin(angle) ** 2) + b) for e, b in zip(facing, behind, strict=True)]
        assert [float(v) for v in radiance.attrib["value"].split(",")] == pytest.approx(expected, rel=1e-5)
    scale = root.find("emitter/float")
    assert scale is not None
    assert scale.attrib["value"] == "2"


# --- USD -----------------------------------------------------------------------------------------------------------


def test_the_stage_has_a_dome_that_is_turned_and_lamps_that_shine_where_they_should() -> None:
    stage = usd(REST, LAMPS, 3.0).texts["light.usda"]
    assert stage.startswith("#usda 1.0\n")
    assert stage.count("{") == stage.count("}") == 2 + len(LAMPS)
    assert 'upAxis = "Z"' in stage
    assert "asset inputs:texture:file = @./light_usd.exr@" in stage
    assert 'token inputs:texture:format = "latlong"' in stage
    dome = stage[stage.index("def DomeLight") : stage.index("def DistantLight")]
    assert "float3 xformOp:rotateXYZ = (90, 0, 0)" in dome
    assert "float inputs:intensity = 3\n" in dome
    for text, lamp in zip(stage.split("def DistantLight")[1:], LAMPS, strict=True):
        matrix = np.array(re.findall(r"-?[\d.]+(?:e-?\d+)?", text.split("transform = ")[1].split("\n")[0]), dtype=float)
        assert matrix.reshape(4, 4)[2, :3] == pytest.approx(lamp.direction, abs=1e-6)  # what its +Z points to
        intensity = re.search(r"inputs:intensity = (\S+)", text)
        colour = re.search(r"inputs:color = \((.*)\)", text)
        assert intensity is not None
        assert colour is not None
        facing = [float(intensity[1]) * float(part) for part in colour[1].split(",")]
        assert facing == pytest.approx([3 * value for value in lamp.irradiance], rel=1e-5)
        assert "bool inputs:normalize = true" in text


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.36, 0.48, -0.8)])
def test_frames_are_rotations(direction: tuple[float, float, float]) -> None:
    matrix = torch.tensor(frame(direction), dtype=torch.float64)
    assert_close(matrix @ matrix.T, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(matrix)) == pytest.approx(1.0)
    assert matrix[2].tolist() == list(direction)


# --- three.js ------------------------------------------------------------------------------------------------------


def test_threejs_takes_half_precision_where_it_holds_the_light() -> None:
    bright = replace(SUNNY, radiance=SUNNY.radiance * 1000)
    texts = [TARGETS["threejs"](light, (), 1.0).texts["light_threejs.js"] for light in (SUNNY, bright)]
    assert ["HalfFloatType" in text for text in texts] == [True, False]
    assert ["THREE.FloatType" in text for text in texts] == [False, True]


def test_threejs_lists_the_lamps() -> None:
    text = handed("threejs").texts["light_threejs.js"]
    found = re.findall(r"direction: \[(.*?)\], irradiance: \[(.*?)\]", text)
    assert len(found) == len(LAMPS)
    for (direction, facing), lamp in zip(found, LAMPS, strict=True):
        assert [float(v) for v in direction.split(",")] == pytest.approx(lamp.direction, abs=1e-6)
        assert [float(v) for v in facing.split(",")] == pytest.approx(lamp.irradiance, rel=1e-6)


# --- OpenEXR, lamps.json -------------------------------------------------------------------------------------------


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reader_of_the_openexr_file_finds_the_light(tmp_path: Path) -> None:
    light = axis_colours(32, dtype=torch.float32)
    content = lamps_content(light, light, (), False, None)
    write_export(tmp_path / "out", [TARGETS["openexr"](light, (), 2.0)], content)
    directions = some_directions()
    found = loaded(tmp_path / "out/light_openexr.py").radiance(directions.numpy())
    assert_close(torch.from_numpy(found).T.float(), 2 * radiance_at(light, directions))


def test_lamps_json_has_directions_sizes_and_confidence() -> None:
    content = lamps_content(SUNNY, REST, LAMPS, True, None)
    sun = content["lamps"][0]
    assert sun["azimuth_degrees"] == pytest.approx(35, abs=0.2)
    assert sun["elevation_degrees"] == pytest.approx(50, abs=0.2)
    assert sun["confidence"] is None
    assert content["confidence_is"].startswith("null: neither confidence.exr")
    whole, rest = (torch.tensor(content[f"plane_irradiance{end}"]) for end in ("", "_without_lamps"))
    assert_close(whole - rest, torch.tensor([it["irradiance_on_plane"] for it in content["lamps"]]).sum(dim=0))
    known = lamps_content(SUNNY, REST, LAMPS, True, torch.full((8, 16), 0.75))
    assert [it["confidence"] for it in known["lamps"]] == [pytest.approx(0.75)] * 3
    assert known["confidence_is"].startswith("mean R_ii")


def test_lamp_properties() -> None:
    lamp = Lamp((0.6, 0.0, 0.8), 2 * math.pi * (1 - math.cos(0.1)), (1.0, 2.0, 4.0), 0.5)
    assert lamp.radius == pytest.approx(0.1)
    assert lamp.colour == (0.25, 0.5, 1.0)
    assert lamp.plane_irradiance == pytest.approx((0.8, 1.6, 3.2))
    assert lamp.radiance[2] == pytest.approx(4 / (math.pi * math.sin(0.1) ** 2))
