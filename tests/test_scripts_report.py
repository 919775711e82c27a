"""The pages in a browser, where there is one: they run, ask for nothing, and a light is exposed and a table sorted."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from batch_case import QUICK, write_photos, write_scene

from torchlight.batch.run import Batch, in_this_process, merge, run_batch
from torchlight.config import Config
from torchlight.io.manifest import read_entries

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
chromium = import_module("chromium")
report_check = import_module("report_check")

pytestmark = pytest.mark.skipif(
    chromium.program() is None, reason="Chromium is not installed; pages are read without a browser in test_report_*"
)


@pytest.fixture(scope="module")
def page() -> Iterator[object]:
    with chromium.browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("batch")
    scene = write_scene(out / "scene.yaml")
    photos = write_photos(out / "photos", scene, 3)
    photos[0].rename(out / "photos/<script>alert(1)<.png")
    config = Config(QUICK.light, checks=QUICK.checks)
    batch = Batch(tuple(read_entries([str(out / "photos/*.png")], scene)), out / "lights", config)
    list(run_batch(batch, in_this_process))
    merge(out / "lights")
    return out / "lights"


def test_the_page_of_a_photograph_works(page: object, folder: Path) -> None:
    for name in ("p001", "<script>alert(1)<"):
        report_check.check_page(page, folder / "photos" / name / "report.html", report_check.check_photo)


def test_the_page_of_a_batch_works(page: object, folder: Path) -> None:
    report_check.check_page(page, folder / "report.html", report_check.check_table)


def test_a_page_that_is_wrong_is_noticed(page: object, folder: Path, tmp_path: Path) -> None:
    good = (folder / "report.html").read_text()
    for piece in ('<img src="https://example.org/a.png" alt="a">', "<p><span data-wide>" + "x" * 600 + "</span></p>"):
        bad = tmp_path / "report.html"
        bad.write_text(good.replace("<main>", f"<main>{piece}").replace("overflow-wrap: anywhere;", ""))
        with pytest.raises(SystemExit, match="report_check"):
            report_check.check_page(page, bad, report_check.check_table)
