from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from realdata import data_path
from torch.testing import assert_close

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.io.exr import read_exr, write_exr
from torchlight.io.lights import read_light, write_light
from torchlight.io.rgbe import write_hdr
from torchlight.light import formats
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import axis_colours


def _colours(height: int = 16) -> EnvironmentMap:
    return axis_colours(height, dtype=torch.float32)


@pytest.mark.parametrize("convention", formats.CONVENTIONS)
def test_exr_round_trips_with_its_convention(tmp_path, convention):
    path = tmp_path / "light.exr"
    signed = EnvironmentMap(_colours().radiance - 0.5, nonnegative=False, units="W/m2/sr")
    write_light(path, signed, {"method": "texels"}, convention=convention)
    back = read_light(path)
    assert_close(back.radiance, signed.radiance, atol=0, rtol=0)
    assert (back.nonnegative, back.units) == (False, "W/m2/sr")
    stored, metadata = read_exr(path)
    assert_close(stored, formats.to_latlong(signed.radiance, convention), atol=0, rtol=0)
    assert metadata == {"convention": convention, "method": "texels", "nonnegative": False, "units": "W/m2/sr"}


def test_only_openexrs_own_convention_is_marked_as_an_envmap(tmp_path):
    for convention, marked in (("openexr", True), ("usd", True), ("torchlight", False), ("skylibs", False)):
        path = tmp_path / f"{convention}.exr"
        write_light(path, _colours(), {}, convention=convention)
        with OpenEXR.File(str(path)) as file:
            header = dict(file.header())
        assert ("envmap" in header) is marked
        assert json.loads(header["torchlight"])["convention"] == convention


def test_a_named_convention_overrides_the_file(tmp_path):
    path = tmp_path / "light.exr"
    write_light(path, _colours(), {})
    turned = read_light(path, "openexr")
    assert_close(turned.radiance, formats.from_latlong(_colours().radiance, "openexr"))


def test_hdr_clips_negative_values(tmp_path):
    path = tmp_path / "light.hdr"
    radiance = _colours().radiance
    radiance[:, 3, 4] = -2.0
    write_light(path, EnvironmentMap(radiance, nonnegative=False), {})
    back = read_light(path)
    assert back.nonnegative
    assert_close(back.radiance[:, 3, 4], torch.zeros(3))
    assert_close(back.radiance, radiance.clamp(min=0), atol=2.0**-8 * radiance.max().item(), rtol=0)


def test_foreign_exr_without_metadata(tmp_path):
    path = tmp_path / "grey.exr"
    pixels = np.linspace(-1, 1, 128, dtype=np.float32).reshape(8, 16)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Y": pixels}).write(
        str(path)
    )
    light = read_light(path)
    assert not light.nonnegative
    assert_close(light.radiance, torch.from_numpy(pixels).expand(3, -1, -1))


def test_crosses_and_angular_maps_are_told_apart_by_shape(tmp_path):
    cross, disc = torch.ones(3, 32, 24), torch.ones(3, 20, 20)
    write_hdr(tmp_path / "cross.hdr", cross)
    write_exr(tmp_path / "disc.exr", disc, {})
    assert_close(read_light(tmp_path / "cross.hdr").radiance, torch.ones(3, 16, 32))
    # a pixel's flux is exact; a constant as good as the balance of areas
    assert_close(read_light(tmp_path / "disc.exr").radiance, torch.ones(3, 20, 40), atol=1e-4, rtol=0)
    with pytest.raises(ConfigError, match="no lat-long but a cube cross"):
        read_light(tmp_path / "cross.hdr", "openexr")


def _one_line(path: Path, match: str) -> None:
    with pytest.raises(FormatError, match=match) as caught:
        read_light(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_bad_files_are_refused_in_one_line(tmp_path):
    _one_line(tmp_path / "absent.exr", "no such file")
    text = tmp_path / "text.hdr"
    text.write_text("hello")
    _one_line(text, "neither OpenEXR nor Radiance")
    odd = tmp_path / "odd.hdr"
    write_hdr(odd, torch.ones(3, 10, 17))
    _one_line(odd, "crop or resample")
    bad = tmp_path / "nan.exr"
    write_exr(bad, torch.full((3, 4, 8), torch.nan), {})
    _one_line(bad, "NaN or infinite")
    lying = tmp_path / "lying.exr"
    write_exr(lying, -torch.ones(3, 4, 8), {"nonnegative": True})
    _one_line(lying, "declared non-negative")
    strange = tmp_path / "strange.exr"
    write_exr(strange, torch.ones(3, 4, 8), {"convention": "mercator"})
    _one_line(strange, "unknown name 'mercator'")


def test_bad_requests_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="choose one of"):
        read_light(tmp_path / "absent.exr", "mercator")
    with pytest.raises(ConfigError, match="choose one of"):
        write_light(tmp_path / "light.exr", _colours(), {}, convention="mercator")
    with pytest.raises(FormatError, match="change the suffix"):
        write_light(tmp_path / "light.png", _colours(), {})
    with pytest.raises(ShapeError, match="one map"):
        write_light(tmp_path / "light.exr", EnvironmentMap(torch.ones(2, 3, 4, 8)), {})
    assert list(tmp_path.iterdir()) == []


def test_real_lat_long_is_read_as_it_is():
    light = read_light(data_path("probes", "noon_grass_1k.hdr"))
    assert light.radiance.shape == (3, 512, 1024)
    assert_close(light.radiance.max().item(), 64_260.0, atol=600, rtol=0)
