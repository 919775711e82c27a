"""The rendered sheet: markers lie where torchlight's camera has them, shadows where trigonometry has them."""

from __future__ import annotations

import math
import sys
from importlib import import_module
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from torchlight.camera import Lens, project
from torchlight.io.images import write_png
from torchlight.photo.target import DEFAULT_PROP, Sheet
from torchlight.report.sheet import sheet_png

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
photographs, sheets, views, chain = (
    import_module(name) for name in ("rendered.photograph", "rendered.sheet", "rendered.sheet_views", "rendered_chain")
)
RING = tuple((x, y) for x in (-48.0, 0.0, 48.0) for y in (-48.0, 0.0, 48.0) if (x, y) != (0.0, 0.0))
SHEET = Sheet((130.0, 140.0), "DICT_4X4_50", 20.0, RING, (70.0, 70.0), (65.0, 75.0))
SMALL = Lens(
    torch.tensor([[660.0, 0, 203.0], [0, 662.0, 146.0], [0, 0, 1]], dtype=torch.float64),
    (400, 300),
    torch.tensor([0.08, -0.21, 0.0011, -0.0007, 0.05], dtype=torch.float64),
)
LAMP = sheets.Lamp(150.0, 60.0, ambient=0.0)


def test_looking_at_keeps_the_x_axis_level_and_rolls_about_the_line_of_sight() -> None:
    place = (100.0, -300.0, 400.0)
    pose = sheets.looking_at(place, (10.0, 20.0), 0.0)
    assert pose[0, 2].item() == pytest.approx(0.0, abs=1e-12)
    assert pose[1, 2].item() < 0  # y runs down the picture
    assert_close(torch.linalg.det(pose[:3, :3]), torch.tensor(1.0, dtype=torch.float64))
    for roll in (0.0, 90.0):
        camera = SMALL.at(sheets.looking_at(place, (10.0, 20.0), roll))
        assert_close(camera.position, torch.tensor(place, dtype=torch.float64))
        aimed = project(camera, torch.tensor([[10.0, 20.0, 0.0]], dtype=torch.float64))[0]
        assert_close(aimed, SMALL.intrinsics[:2, 2])
    with pytest.raises(ValueError, match="straight above"):
        sheets.looking_at((1.0, 2.0, 3.0), (1.0, 2.0), 0.0)


def test_errors_of_a_pose_are_a_distance_and_an_angle() -> None:
    true = sheets.looking_at((100.0, -300.0, 400.0), (0.0, 0.0), 12.0)
    angle = math.radians(0.3)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    found = turn @ true
    found[:3, 3] = true[:3, 3] + torch.tensor([0.3, 0.0, 0.4], dtype=torch.float64)
    assert chain.off(found, true) == pytest.approx((0.5, 0.3))


def test_the_rendered_sheet_gives_its_pose_and_the_block_its_shadow(tmp_path: Path) -> None:
    if not photographs.installed():
        pytest.skip("Mitsuba 3 is not installed")
    (tmp_path / "target.png").write_bytes(sheet_png(SHEET, DEFAULT_PROP))
    camera = SMALL.at(views.from_direction(-70.0, 72.0, 430.0, roll=75.0))
    objects = {**sheets.printed(tmp_path / "target.png", SHEET), **sheets.standing(DEFAULT_PROP)}
    light = sheets.picture(objects, camera, SHEET, LAMP, 4, 2)
    write_png(tmp_path / "photo.png", photographs.stored(light, 0.85, 0.01, 1))
    seen = chain.look(tmp_path / "photo.png", SHEET, SMALL, camera)
    assert (seen.markers, seen.wrong) == (len(SHEET.markers), 0)
    assert seen.rms < 0.15  # pixels
    assert seen.origin < 0.3  # millimetres
    assert seen.turn < 0.2  # degrees
    away = -DEFAULT_PROP.height * torch.from_numpy(LAMP.direction) / LAMP.direction[2]
    tip = torch.stack([away * 0.8, torch.tensor([-away[0], away[1], 0.0]) * 0.8])  # in the shadow, and mirrored
    tip[:, 2] = 0
    column, row = project(camera, tip).round().long().unbind(dim=-1)
    shadow, lit = light[0, row, column].tolist()
    assert lit == pytest.approx(sheets.PAPER, rel=0.02)
    assert shadow < 0.05 * lit
