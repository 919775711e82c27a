"""report.html of a batch: every photograph has its line, failures their reason, and names mean nothing to a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from batch_case import QUICK, write_photos, write_scene
from pages import check_self_contained, read

from torchlight.batch.report import REPORT
from torchlight.batch.run import Batch, in_this_process, merge, run_batch
from torchlight.config import Checks, Config, Output
from torchlight.io.manifest import read_entries
from torchlight.report import batch_page
from torchlight.report.panels import jpeg

NASTY = "day/<script>alert(1)<&script> #?%41 \"'"


def row(name: str, state: str = "done", reason: str = "", **more: Any) -> dict[str, Any]:
    figures = {"rms_255": 0.25, "visible": 3846, "near": False, "peak_share": 0.4} if state == "done" else {}
    return {
        "name": name,
        "photo": f"{name}.png",
        "scene": "s.yaml",
        "state": state,
        "reason": reason,
        **figures,
        **more,
    }


def page_of(rows: list[dict[str, Any]]) -> bytes:
    thumbnails = {item["name"]: jpeg(np.zeros((52, 180, 3), dtype=np.uint8), 70) for item in rows[:2]}
    links = {item["name"]: f"photos/{item['name']}/report.html" for item in rows if item["state"] == "done"}
    return batch_page.batch_page("lights", rows, [("broken file", 1)], thumbnails, links)


def test_every_photograph_has_a_line_that_a_heading_sorts() -> None:
    rows = [row("a"), row(NASTY, warnings=2), row("c", "failed", "broken <i>file"), row("d", "pending")]
    content = page_of(rows)
    page = read(content)
    check_self_contained(page, links=2)
    assert b"<script>alert" not in content
    assert "2 of 4 photographs done, 1 failed, 1 pending. Error, of 255: median 0.25, worst 0.25." in page.text
    assert page.text.count("broken <i>file") == 2
    assert [unquote(str(found["href"])) for found in page.every("a")] == [
        "photos/a/report.html",
        f"photos/{NASTY}/report.html",
    ]
    assert len(page.every("tr")) == 1 + len(rows)
    assert len(page.every("img")) == 2
    assert all(image["loading"] == "lazy" for image in page.every("img"))
    buttons = [found for found in page.every("button") if found.get("id") != "more"]
    assert len(buttons) == len(page.every("th")) - 1
    assert "functions" not in page.text  # no row has any
    assert page_of(rows) == content


def test_numbers_carry_themselves_and_what_is_not_there_is_empty() -> None:
    page = read(page_of([row("a", rms_255=0.123456789), row("b", rms_255=None, **{"tag.sky": "a < b"})]))
    values = [found["data-value"] for found in page.every("td") if "data-value" in found]
    assert "0.123456789" in values
    assert "" in values
    assert "a < b" in page.text
    assert "sky" in page.text


def test_a_page_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_page, "MOST_ROWS", 5)
    monkeypatch.setattr(batch_page, "MOST_FAILURES", 2)
    rows = [row(f"p{index}", *(("failed", "torn") if index > 16 else ())) for index in range(20)]
    assert [item["name"] for item in batch_page.chosen(rows)] == ["p0", "p1", "p17", "p18", "p19"]
    page = read(page_of(rows))
    assert "5 of 20 photographs are shown here" in page.text
    assert "and 1 more" in page.text
    assert len(page.every("tr")) == 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("batch")
    scene = write_scene(out / "scene.yaml")
    photos = write_photos(out / "photos", scene, 3)
    photos[1].write_bytes(photos[1].read_bytes()[:60])
    photos[2].rename(out / "photos/<i>&.png")
    reported = Config(QUICK.light, checks=Checks(skip_near_test=True))
    batch = Batch(tuple(read_entries([str(out / "photos/*.png")], scene)), out / "lights", reported)
    list(run_batch(batch, in_this_process))
    return out / "lights"


def test_a_batch_has_a_report_that_leads_to_those_of_its_photographs(folder: Path) -> None:
    merge(folder)
    content = (folder / REPORT).read_bytes()
    page = read(content)
    check_self_contained(page, links=2)
    assert "2 of 3 photographs done, 1 failed" in page.text
    assert "p001" in page.text
    linked = [folder / unquote(str(found["href"])) for found in page.every("a")]
    assert [path.is_file() for path in linked] == [True, True]
    assert [path.name for path in linked] == [REPORT, REPORT]
    assert len(page.every("img")) == 2
    check_self_contained(read(linked[0].read_bytes()))
    (folder / REPORT).unlink()
    merge(folder)
    assert (folder / REPORT).read_bytes() == content


def test_a_photograph_that_lost_its_picture_has_a_line_without(folder: Path) -> None:
    thumbnail = folder / "photos/p000/thumbnail.jpg"
    data = thumbnail.read_bytes()
    thumbnail.write_bytes(b"")
    merge(folder)
    thumbnail.write_bytes(data)
    assert len(read((folder / REPORT).read_bytes()).every("img")) == 1


@pytest.mark.parametrize("output", [Output(skip_report=True), Output(skip_pictures=True)])
def test_reports_can_be_left_out(tmp_path: Path, output: Output) -> None:
    scene = write_scene(tmp_path / "scene.yaml")
    write_photos(tmp_path / "photos", scene, 1)
    config = Config(QUICK.light, checks=QUICK.checks, output=output)
    batch = Batch(tuple(read_entries([str(tmp_path / "photos/*.png")], scene)), tmp_path / "lights", config)
    list(run_batch(batch, in_this_process))
    merge(tmp_path / "lights")
    here = tmp_path / "lights"
    assert (here / REPORT).exists() == (not output.skip_report)
    assert not (here / "photos/p000/report.html").exists()
    assert not (here / "photos/p000/thumbnail.jpg").exists()
    if not output.skip_report:
        page = read((here / REPORT).read_bytes())
        check_self_contained(page, links=1)
        assert page.every("a")[0]["href"] == "photos/p000/light.png"
