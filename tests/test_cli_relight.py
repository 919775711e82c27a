"""`torchlight relight`: photographs under another light, and without shadows."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from test_cli_insert import codes
from torch.testing import assert_close
from workbench import exr, light, png, scene_file, shadow, torchlight

from torchlight.io.exr import read_exr
from torchlight.light.procedural import sun_and_window


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A rectified photograph, its scene, its light and another one."""
    scene_file(tmp_path)
    png(tmp_path / "photo.png")
    exr(tmp_path / "photo.exr")
    light(tmp_path / "light.exr", 32)
    exr(tmp_path / "other.exr", sun_and_window(32).radiance.roll(20, dims=-1))
    return tmp_path


def relight(desk: Path, *more: object, new: str = "light.exr", photo: str = "photo.png", out: str = "out.png"):
    given = (desk / "scene.yaml", desk / new, "--photo", desk / photo, "--out", desk / out, "--rays", 512)
    return torchlight("relight", *given, *more)


def test_the_same_light_changes_nothing(desk: Path) -> None:
    ran = relight(desk, "--from", desk / "light.exr")
    assert ran.code == 0, ran.err
    assert torch.equal(codes(desk / "out.png"), codes(desk / "photo.png"))
    assert "0 pixels (0.0%) held" in ran.out


def test_another_light_moves_the_shadow(desk: Path) -> None:
    ran = relight(desk, "--from", desk / "light.exr", new="other.exr", photo="photo.exr", out="out.exr")
    assert ran.code == 0, ran.err
    made, _ = read_exr(desk / "out.exr")
    change = made / shadow().clamp(min=1e-6)
    assert change.max() > 1.3
    assert change.min() < 0.7


@pytest.mark.parametrize("hole", ["fill", "transparent", "keep"])
def test_without_its_shadow_the_plane_is_even(desk: Path, hole: str) -> None:
    ran = relight(desk, "--remove-shadow", "--hole", hole)
    assert ran.code == 0, ran.err
    made = codes(desk / "out.png").double()
    assert made.shape[-1] == (4 if hole == "transparent" else 3)
    ring = torch.cat([made[0], made[-1], made[:, 0], made[:, -1]])[:, :3]
    before = codes(desk / "photo.png").double()
    edge = torch.cat([before[0], before[-1], before[:, 0], before[:, -1]])
    assert ring.std(dim=0).max() < 0.5 * edge.std(dim=0).max()
    middle = made[7:9, 7:9].reshape(4, -1)
    if hole == "fill":
        assert_close(middle.mean(dim=0), ring.mean(dim=0), rtol=0.1, atol=0)
    if hole == "transparent":
        assert (middle[:, 3] == 0).all()
    if hole == "keep":
        assert torch.equal(middle, before[7:9, 7:9].reshape(4, -1))


@pytest.mark.parametrize(
    ("more", "out", "message"),
    [
        ((), "out.png", "give either --from OLD_LIGHT"),
        (("--remove-shadow", "--from", "light.exr"), "out.png", "give either --from OLD_LIGHT"),
        (("--remove-shadow", "--gain", 0.5), "out.png", "gain: expected a bound of at least 1"),
        (("--remove-shadow", "--exposure", 0), "out.png", "--exposure: expected a positive number"),
        (
            ("--remove-shadow", "--hole", "transparent"),
            "out.jpg",
            "expected a name that ends in .png or .exr, which hold",
        ),
        (("--remove-shadow",), "out.tif", "expected a name that ends in .png"),
        (("--remove-shadow",), "photo.png", "already there"),
    ],
)
def test_one_line_for_what_cannot_be(desk: Path, more: tuple[object, ...], out: str, message: str) -> None:
    ran = relight(desk, *more, out=out)
    assert ran.code == 2
    assert message in ran.line
