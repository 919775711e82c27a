"""What benchmarks state alike, how the page is filled from it, and that a start brings nothing that is not needed."""

from __future__ import annotations

import csv
import subprocess
import sys
from importlib import import_module
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
measuring = import_module("bench.measuring")
draw_performance = import_module("draw_performance")

ROWS = [
    {"case": "sorting, few", "peer": "by hand", "ratio": 12.5, "asked": 10.0, "faces": 81920},
    {"case": "sorting, many", "peer": "by hand", "ratio": 0.5, "faces": 12, "note": "slow"},
]


def test_every_row_states_machine_threads_and_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = measuring.save("sorting", ROWS, 3, tmp_path / "new")
    with path.open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [row["case"] for row in found] == ["sorting, few", "sorting, many"]
    assert found[0]["note"] == found[1]["asked"] == ""
    for row in found:
        assert row["threads"] == "3"
        assert "3 threads" in row["machine"]
        assert 0.01 < float(row["peak memory of the run, GiB"]) <= measuring.peak_gib() + 1e-3
    assert "3 threads" in capsys.readouterr().out


def test_the_best_of_some_runs_is_the_least_of_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, processor = iter([0.0, 5.0, 10.0, 13.0]), iter([0.0, 2.0, 10.0, 14.0])
    monkeypatch.setattr(measuring.time, "perf_counter", lambda: next(wall))
    monkeypatch.setattr(measuring.time, "process_time", lambda: next(processor))
    assert measuring.best(lambda: "done", 2) == ("done", measuring.Cost(3.0, 2.0))


def test_a_table_has_all_columns_and_leaves_open_what_a_row_lacks() -> None:
    lines = measuring.markdown([{"a": 81920, "b": 0.123456}, {"a": 1234.5, "c": None, "d": "x"}]).splitlines()
    assert lines == [
        "| a | b | c | d |",
        "| --- | --- | --- | --- |",
        "| 81,920 | 0.123 |  |  |",
        "| 1,234 |  |  | x |",
    ]


def test_a_page_gets_the_tables_that_were_measured_and_keeps_the_others(tmp_path: Path) -> None:
    measuring.save("sorting", ROWS, 2, tmp_path)
    page = tmp_path / "docs" / "page.md"
    (page.parent / "images").mkdir(parents=True)
    other = "<!-- table: other -->\nkept\n<!-- end -->\nend\n"
    page.write_text(f"# Title\n<!-- table: sorting -->\nold\n<!-- end -->\n{other}")
    draw_performance.main(tmp_path, page)
    text = page.read_text()
    assert "old" not in text
    assert text.endswith(other)
    assert "| sorting, few | by hand | 12.5 | 10 | 81,920 |" in text
    assert "2 threads;" in text
    again = text
    draw_performance.main(tmp_path, page)
    assert page.read_text() == again
    picture = np.asarray(Image.open(page.parent / "images" / "performance.png"))
    assert picture.shape[1] == 990


def test_bars_are_as_long_as_the_logarithm_of_the_ratio() -> None:
    some = [{"case": "a", "peer": "b", "ratio": ratio} for ratio in ("10", "100")]
    picture = np.asarray(Image.open(BytesIO(draw_performance.ratios_picture(some))))[..., :3].astype(int)
    blue = abs(picture - [0x00, 0x72, 0xB2]).max(axis=-1) <= 1
    short, long = np.sort(blue.sum(axis=1)[blue.sum(axis=1) > 0])[[5, -5]]
    left = blue.any(axis=0).argmax()
    assert left < short < long  # both begin at the picture's left, below a ratio of 1
    decade = (long - short) / picture.shape[1]
    assert 0.15 < decade < 0.6


def test_without_measurements_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no CSV files"):
        draw_performance.main(tmp_path, tmp_path / "page.md")


@pytest.mark.parametrize(
    ("module", "absent"), [("torchlight.cli", "torch"), ("torchlight.cli.estimate", "kornia"), ("torchlight", "torch")]
)
def test_a_start_brings_nothing_that_is_not_needed(module: str, absent: str) -> None:
    asked = f"import sys, {module}; sys.exit('{absent}' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", asked], check=False).returncode == 0
