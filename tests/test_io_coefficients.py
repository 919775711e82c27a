"""Spherical harmonics as JSON: what is stated, read back as light, and bad files in one line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, FormatError
from torchlight.io.coefficients import write_coefficients
from torchlight.io.lights import read_light, read_sampled
from torchlight.light.environment import EnvironmentMap, power
from torchlight.light.projection import cosine_factors, project
from torchlight.light.sampled import sampled
from torchlight.light_plane import LightPlane


def light() -> EnvironmentMap:
    radiance = torch.rand(3, 8, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return EnvironmentMap(radiance, units="W/m2/sr", plane=LightPlane(3.0, (1.0, 2.0)))


def test_the_file_says_what_its_numbers_mean(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "light.json", sampled(light()), 3, {"method": "texels"})
    content = json.loads((tmp_path / "light.json").read_text())
    assert content["degree"] == 3
    assert content["cosine_convolved"] is False
    assert content["units"] == "W/m2/sr"
    assert content["primaries"] == "rec709"
    assert content["metadata"] == {"method": "texels"}
    assert "Condon-Shortley" in content["basis"]
    assert content["index"].startswith("l (l + 1) + m")
    values = torch.tensor([content[colour] for colour in ("red", "green", "blue")], dtype=torch.float64)
    assert_close(values, project(light().radiance, 3))
    assert_close(values[:, 0] * math.sqrt(4 * math.pi), power(light()))


@pytest.mark.parametrize("convolved", [False, True])
@pytest.mark.parametrize("primaries", ["rec709", "acescg"])
def test_it_is_light_again(tmp_path: Path, convolved: bool, primaries: str) -> None:
    path = tmp_path / "light.json"
    write_coefficients(path, sampled(light()), 2, {}, cosine_convolved=convolved, primaries=primaries)
    back = read_light(path)
    assert_close(power(back).double(), power(light()), rtol=1e-6, atol=0)
    assert_close(project(back.radiance.double(), 2), project(light().radiance, 2), rtol=0, atol=1e-3)
    assert (back.units, back.plane, back.nonnegative) == ("W/m2/sr", light().plane, not bool((back.radiance < 0).any()))


def test_convolved_coefficients_are_those_times_a_l_and_odd_degrees_are_lost(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "light.json", sampled(light()), 4, {}, cosine_convolved=True)
    content = json.loads((tmp_path / "light.json").read_text())
    assert_close(torch.tensor(content["red"], dtype=torch.float64), project(light().radiance, 4)[0] * cosine_factors(4))
    assert "irradiance" in content["quantity"]
    back = project(read_light(tmp_path / "light.json").radiance.double(), 4)
    assert_close(back[:, 9:16], torch.zeros(3, 7, dtype=torch.float64), rtol=0, atol=1e-4)  # of averages over pixels
    assert_close(back[:, 16:], project(light().radiance, 4)[:, 16:], rtol=0, atol=1e-3)


def content() -> dict[str, object]:
    return {
        "format": "spherical harmonics",
        "degree": 0,
        "cosine_convolved": False,
        "red": [1],
        "green": [2],
        "blue": [3],
    }


def test_the_least_a_file_must_say(tmp_path: Path) -> None:
    (tmp_path / "light.json").write_text(json.dumps(content()))
    radiance = read_sampled(tmp_path / "light.json").radiance
    assert_close(radiance[:, 0], torch.tensor([1.0, 2.0, 3.0]) / math.sqrt(4 * math.pi))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "photograph"}, "no other JSON is light"),
        ({"degree": 1}, "red: expected a list of 4 numbers"),
        ({"degree": 900}, "expected 0 to 64"),
        ({"degree": 0.5}, "degree"),
        ({"red": ["x"]}, "red"),
        ({"red": None}, "red"),
        ({"cosine_convolved": "yes"}, "true or false"),
        ({"primaries": "p3"}, "primaries"),
        ({"light_plane": {"height": -1, "center": [0, 0]}}, "light_plane"),
        ({"colour": 1}, "unknown key"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, change: dict[str, object], message: str) -> None:
    path = tmp_path / "light.json"
    path.write_text(json.dumps({**content(), **change}))
    with pytest.raises(FormatError, match=message) as caught:
        read_light(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", ["format", "degree", "cosine_convolved", "blue"])
def test_what_is_missing_is_named(tmp_path: Path, missing: str) -> None:
    path = tmp_path / "light.json"
    path.write_text(json.dumps({key: value for key, value in content().items() if key != missing}))
    with pytest.raises(FormatError, match=missing):
        read_light(path)


def test_bad_json_and_bad_requests_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "light.json"
    path.write_text('{"red": [1,')
    with pytest.raises(FormatError, match="not JSON"):
        read_light(path)
    path.write_text('{"red": ' + "[" * 100_000)
    with pytest.raises(FormatError, match="not JSON"):
        read_light(path)
    path.write_text(json.dumps({**content(), "red": [math.nan]}))
    with pytest.raises(FormatError, match="finite"):
        read_light(path)
    with pytest.raises(ConfigError, match="whose axes are fixed"):
        read_light(path, "openexr")
    with pytest.raises(ConfigError, match="0 to 64"):
        write_coefficients(path, sampled(light()), 65, {})
