"""The sheet's file: what is written is read, and mistakes are one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from torch.testing import assert_close

from torchlight.errors import CalibrationError, ConfigError, TorchlightError
from torchlight.geometry.primitives import box
from torchlight.geometry.transforms import transform
from torchlight.io.fields import Field
from torchlight.io.occluders import read_occluders
from torchlight.io.target_file import read_target, write_target
from torchlight.io.yaml_file import read_yaml
from torchlight.photo.target import DEFAULT_PROP, PAPERS, Prop, footprint, make_sheet


@pytest.mark.parametrize("paper", PAPERS)
def test_a_sheet_comes_back_as_it_was(tmp_path: Path, paper: str) -> None:
    write_target(tmp_path / "target.yaml", make_sheet(paper), DEFAULT_PROP)
    assert read_target(tmp_path / "target.yaml") == make_sheet(paper)


@pytest.mark.parametrize(
    "prop",
    [Prop("box", (30.0, 20.0, 35.0), (5.0, -6.0), 30.0), Prop("cylinder", (9.0, 25.0)), Prop("cone", (9.0, 25.0))],
)
def test_the_occluders_are_a_scene_files_and_stand_on_the_footprint(tmp_path: Path, prop: Prop) -> None:
    path = tmp_path / "target.yaml"
    write_target(path, make_sheet("A4"), prop)
    document, _ = read_yaml(path)
    assert isinstance(document, dict)
    triangles = read_occluders(Field(document["occluders"], path, "occluders"))
    standing = triangles.reshape(-1, 3)
    outline = footprint(prop)
    assert_close(standing[:, :2].amin(0), outline.amin(0), atol=1e-2, rtol=0)
    assert_close(standing[:, :2].amax(0), outline.amax(0), atol=1e-2, rtol=0)
    assert standing[:, 2].max().item() == prop.height
    if prop.shape == "box":
        expected = transform(box((30.0, 20.0, 35.0)), 1.0, (0.0, 0.0, 30.0), (5.0, -6.0, 0.0))
        assert_close(triangles, expected.to(triangles))


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("measured: 100", "measured: 96.8", CalibrationError, "ruler: it should measure 100 mm but measures 96.8 mm"),
        ("marker_size: 20", "marker_size: -1", CalibrationError, "marker_size: expected a number above 0"),
        ("dictionary: DICT_4X4_50", "dictionary: DICT_4X4_51", ConfigError, "OpenCV has no DICT_4X4_51"),
        ("paper:", "papers:", ConfigError, "did you mean 'paper'?"),
        ("[-87, -125.5]", "[-87]", ConfigError, "markers[0]"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, old: str, new: str, error: type[TorchlightError], message: str) -> None:
    path = tmp_path / "target.yaml"
    write_target(path, make_sheet("A4"), DEFAULT_PROP)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(error) as caught:
        read_target(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_fields_are_needed(tmp_path: Path) -> None:
    (tmp_path / "target.yaml").write_text("paper: [210, 297]\n")
    with pytest.raises(ConfigError, match="origin: missing"):
        read_target(tmp_path / "target.yaml")
