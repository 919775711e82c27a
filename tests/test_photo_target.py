"""The printed sheet's geometry, and how low a light may stand, against shadows thrown one by one."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import CalibrationError, ConfigError
from torchlight.photo.target import (
    DEFAULT_PROP,
    PAPERS,
    Prop,
    Sheet,
    check_ruler,
    footprint,
    make_sheet,
    marker_corners,
    shadow_reach,
    top,
)


@pytest.mark.parametrize("paper", PAPERS)
def test_markers_stand_apart_on_all_four_sides_around_a_clean_inside(paper: str) -> None:
    sheet = make_sheet(paper)
    corners = marker_corners(sheet)[..., :2]
    width, height = sheet.inside
    low, high = corners.amin(1), corners.amax(1)
    outside = (low[:, 0] >= width / 2) | (high[:, 0] <= -width / 2) | (low[:, 1] >= height / 2)
    assert bool((outside | (high[:, 1] <= -height / 2)).all())
    centers = torch.tensor(sheet.markers, dtype=torch.float64)
    gaps = (centers[:, None] - centers).abs().amax(-1) - sheet.marker_size
    gaps.fill_diagonal_(math.inf)
    assert gaps.min().item() >= sheet.marker_size / 3 - 1e-3
    for axis in (0, 1):  # at least four on each side
        for side in (centers[:, axis].min(), centers[:, axis].max()):
            assert int((centers[:, axis] == side).sum()) >= 4
    page = corners + torch.tensor(sheet.origin, dtype=torch.float64)
    assert page.min().item() >= 8
    assert bool((page.amax((0, 1)) <= torch.tensor(sheet.paper, dtype=torch.float64) - 8).all())
    assert len(set(sheet.markers)) == len(sheet.markers) <= 50


def test_marker_corners_begin_at_the_upper_left_and_go_clockwise_from_above() -> None:
    sheet = Sheet((100.0, 100.0), "DICT_4X4_50", 10.0, ((20.0, 30.0),), (20.0, 20.0), (50.0, 50.0))
    expected = [[15.0, 35, 0], [25, 35, 0], [25, 25, 0], [15, 25, 0]]
    assert_close(marker_corners(sheet)[0], torch.tensor(expected, dtype=torch.float64))


def test_the_footprint_of_a_turned_box_has_its_corners_where_trigonometry_puts_them() -> None:
    outline = footprint(Prop("box", (30.0, 20.0, 35.0), (5.0, -7.0), 90.0))
    expected = torch.tensor([[15.0, -22], [15, 8], [-5, 8], [-5, -22]], dtype=torch.float64)
    assert_close(outline, expected)
    assert_close(top(Prop("cone", (10.0, 40.0), (3.0, 4.0))), torch.tensor([[3.0, 4.0]], dtype=torch.float64))
    round_outline = footprint(Prop("cylinder", (10.0, 40.0), (3.0, 4.0)))
    radius = (round_outline - torch.tensor([3.0, 4.0])).norm(dim=-1)
    assert_close(radius, torch.full_like(radius, 10.0))


def thrown(prop: Prop, elevation_degrees: float, azimuth: float) -> torch.Tensor:
    length = prop.height / math.tan(math.radians(elevation_degrees))
    way = torch.tensor([math.cos(azimuth), math.sin(azimuth)], dtype=torch.float64)
    return top(prop) + length * way


@pytest.mark.parametrize(
    "prop", [DEFAULT_PROP, Prop("cone", (8.0, 25.0), (20.0, -30.0)), Prop("cylinder", (12.0, 30.0), (-15.0, 10.0))]
)
def test_the_limits_are_where_shadows_thrown_all_round_first_leave(prop: Prop) -> None:
    sheet = make_sheet("A4")
    reach = shadow_reach(sheet, prop)
    middle = torch.tensor(sheet.paper, dtype=torch.float64) / 2 - torch.tensor(sheet.origin, dtype=torch.float64)
    inside, page = torch.tensor(sheet.inside).double() / 2, torch.tensor(sheet.paper).double() / 2
    azimuths = [2 * math.pi * k / 720 for k in range(720)]

    def within(elevation: float, around: torch.Tensor, half: torch.Tensor) -> bool:
        return all(bool(((thrown(prop, elevation, a) - around).abs() <= half).all()) for a in azimuths)

    nowhere = torch.zeros(2, dtype=torch.float64)
    assert within(reach.inside_degrees + 0.02, nowhere, inside)
    assert not within(reach.inside_degrees - 0.02, nowhere, inside)
    assert within(reach.sheet_degrees + 0.02, middle, page)
    assert not within(reach.sheet_degrees - 0.02, middle, page)
    assert reach.sheet_degrees < reach.inside_degrees


def test_markers_at_risk_are_those_that_sampled_shadows_meet() -> None:
    sheet, prop = make_sheet("A4"), Prop("cone", (8.0, 40.0), (25.0, 50.0))
    reach = shadow_reach(sheet, prop)
    squares = marker_corners(sheet)[..., :2]
    met = set()
    for k in range(3600):
        tip = thrown(prop, reach.sheet_degrees, 2 * math.pi * k / 3600)[0]
        shares = torch.linspace(0, 1, 200, dtype=torch.float64)[:, None]
        line = top(prop)[0] + shares * (tip - top(prop)[0])  # of an apex, the shadow is below the line of all lights
        hit = ((line[:, None] >= squares.amin(1)) & (line[:, None] <= squares.amax(1))).all(-1).any(0)
        met |= set(hit.nonzero().flatten().tolist())
    assert met == set(reach.markers)


def test_what_cannot_be_is_one_line() -> None:
    sheet = make_sheet("A4")
    with pytest.raises(ConfigError, match=r"must stand within the clean white, 144 x 221 mm .* 3.0 mm beyond"):
        shadow_reach(sheet, Prop("box", (20.0, 20.0, 20.0), (65.0, 0.0)))
    with pytest.raises(ConfigError, match="expected box:x,y,z"):
        Prop("pyramid", (1.0, 2.0, 3.0))
    with pytest.raises(ConfigError, match="got box:1,2"):
        Prop("box", (1.0, 2.0))
    with pytest.raises(ConfigError, match="paper: expected A4"):
        make_sheet("A5")


def test_a_print_that_is_not_to_scale_is_refused_with_its_scale() -> None:
    check_ruler(100.0, 100.4)
    check_ruler(100.0, 99.6)
    with pytest.raises(CalibrationError, match=r"should measure 100 mm but measures 97 mm, so the print is at 97.0%"):
        check_ruler(100.0, 97.0)
