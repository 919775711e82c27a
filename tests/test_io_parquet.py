"""results.parquet: what results.jsonl holds, column by column with types, and one line where pyarrow is missing."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from batch_case import QUICK, write_photos, write_scene
from workbench import Ran
from workbench import torchlight as run

from torchlight.batch.table import COLUMNS
from torchlight.errors import FormatError
from torchlight.io.parquet import write_parquet

OPTIONS = ("--method", QUICK.light.method, "--resolution", QUICK.light.resolution, "--skip-near-test", "--workers", 0)
LINES = """{"photo": "photos/p000.png", "tags": {"sky": "clear", "hour": "9"}}
{"photo": "photos/p001.png", "tags": {"hour": "10"}}
{"photo": "photos/p002.png"}
"""


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parquet")
    photos = write_photos(folder / "photos", write_scene(folder / "scene.yaml"), 3)
    photos[2].write_bytes(b"not a photograph")
    (folder / "list.jsonl").write_text(LINES)
    return folder / "list.jsonl"


def batch(manifest: Path, out: Path, *options: object) -> Ran:
    scene = manifest.parent / "scene.yaml"
    return run("batch", manifest, "--scene", scene, "--out", out, "--skip-pictures", *OPTIONS, *options)


def pyarrow() -> Any:
    return pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed (extra parquet)")


def test_the_table_holds_what_the_lines_hold(manifest: Path, tmp_path: Path) -> None:
    parquet = pyarrow()
    assert batch(manifest, tmp_path / "out", "--parquet").code == 1
    table = parquet.read_table(tmp_path / "out" / "results.parquet")
    lines = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    assert list(table.column_names) == [*COLUMNS, "tag.sky", "tag.hour"]
    assert set(table.column_names) == {key for line in lines for key in line}
    for found, expected in zip(table.to_pylist(), lines, strict=True):
        assert found == {name: expected.get(name) for name in table.column_names}
    kinds = {name: str(table.schema.field(name).type) for name in table.column_names}
    assert kinds == {name: kind.replace("float64", "double") for name, kind in COLUMNS.items()} | {
        "tag.sky": "string",
        "tag.hour": "string",
    }
    assert [row["state"] for row in table.to_pylist()] == ["done", "done", "failed"]


def test_a_table_that_is_there_is_kept_in_step(manifest: Path, tmp_path: Path) -> None:
    parquet = pyarrow()
    out = tmp_path / "out"
    batch(manifest, out)
    assert not (out / "results.parquet").exists()
    assert run("batch", "--merge", out, "--parquet").code == 1
    (out / "photos" / "photos" / "p001").rename(tmp_path / "elsewhere")
    assert run("batch", "--merge", out).code == 1
    states = parquet.read_table(out / "results.parquet").column("state").to_pylist()
    assert states == ["done", "pending", "failed"]


def test_columns_keep_their_types_where_nothing_is_known(tmp_path: Path) -> None:
    parquet = pyarrow()
    write_parquet(tmp_path / "t.parquet", [{"name": "a\udcff", "state": "pending"}], COLUMNS)
    (row,) = parquet.read_table(tmp_path / "t.parquet").to_pylist()
    assert row == dict.fromkeys(COLUMNS) | {"name": "a\\udcff", "state": "pending"}
    with pytest.raises(FormatError, match="cannot be written"):
        write_parquet(tmp_path / "none" / "t.parquet", [], COLUMNS)
    assert [path.name for path in tmp_path.iterdir()] == ["t.parquet"]


def test_without_pyarrow_one_line_says_so(manifest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    ran = batch(manifest, tmp_path / "out", "--parquet")
    assert (ran.code, ran.out) == (2, "")
    assert ran.line == "torchlight: --parquet: pyarrow is not installed; pip install 'torchlight[parquet]'"
    assert not (tmp_path / "out").exists()
