"""Batches: every photograph ends one way, nothing is done twice, and an interrupted batch ends like another."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from batch_case import QUICK, QUICK_UNCACHED, fingerprints, write_photos, write_scene

from torchlight.batch import ending
from torchlight.batch.blocks import Block, Shard
from torchlight.batch.looking import look
from torchlight.batch.run import Batch, Engine, finished, in_this_process, merge, run_batch
from torchlight.batch.scenes import setting_of
from torchlight.batch.table import reasons
from torchlight.batch.work import Report, Task
from torchlight.errors import ConfigError, FormatError
from torchlight.io.images import read_photo
from torchlight.io.manifest import Entry, read_entries

COUNT = 19


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Entry, ...]:
    folder = tmp_path_factory.mktemp("batch")
    scene = write_scene(folder / "scene.yaml")
    write_photos(folder / "photos", scene, COUNT)
    (folder / "photos" / "p007.png").write_bytes(b"\x89PNG\r\n\x1a\n truncated")
    return tuple(read_entries([str(folder / "photos" / "*.png")], scene))


@pytest.fixture(scope="module")
def undisturbed(asked: tuple[Entry, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    done(Batch(asked, out, QUICK))
    merge(out)
    return out


def done(batch: Batch, engine: Engine = in_this_process) -> list[tuple[str, str]]:
    """Returns name and state of what a run did."""
    return [(step.record.name, step.record.state) for step in run_batch(batch, engine)]


def test_every_photograph_ends_one_way(undisturbed: Path, asked: tuple[Entry, ...]) -> None:
    rows = [json.loads(line) for line in (undisturbed / "results.jsonl").read_text().splitlines()]
    assert [row["name"] for row in rows] == [entry.name for entry in asked]
    assert [row["name"] for row in rows if row["state"] == "failed"] == ["p007"]
    assert "p007.png" in rows[7]["reason"]
    assert all(row["rms_255"] < 0.2 for row in rows if row["state"] == "done")
    assert not (undisturbed / "photos" / "p007").exists()
    table = (undisturbed / "results.csv").read_text().splitlines()
    assert len(table) == COUNT + 1
    assert table[0].startswith("name,photo,scene,state,reason,warnings,rms_255")


def test_reasons_are_counted_without_names() -> None:
    rows = [{"state": "failed", "photo": f"/a/{i}.png", "reason": f"a/{i}.png: truncated"} for i in range(3)]
    rows += [{"state": "failed", "photo": "/a/9.png", "reason": "not enough memory"}]
    rows += [{"state": "done", "photo": "/a/8.png", "reason": ""}]
    assert reasons(rows) == [("truncated", 3), ("not enough memory", 1)]


def test_a_second_run_does_nothing(undisturbed: Path, asked: tuple[Entry, ...]) -> None:
    before = fingerprints(undisturbed)
    assert done(Batch(asked, undisturbed, QUICK)) == []
    assert fingerprints(undisturbed) == before
    assert finished(undisturbed)


@pytest.mark.parametrize("stop", [1, 5, 8, 9])
def test_an_interrupted_batch_ends_like_another(
    undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path, stop: int
) -> None:
    steps = run_batch(Batch(asked, tmp_path / "out", QUICK), in_this_process)
    first = [next(steps).record.name for _ in range(stop)]
    steps.close()
    assert not finished(tmp_path / "out")
    rest = [name for name, _ in done(Batch(asked, tmp_path / "out", QUICK))]
    # of the block in flight folders are complete that the journal does not name yet: they are not done again
    assert not set(first) & set(rest)
    assert fingerprints(tmp_path / "out") == fingerprints(undisturbed)
    merge(tmp_path / "out")
    assert (tmp_path / "out/results.csv").read_bytes() == (undisturbed / "results.csv").read_bytes()


def test_what_a_killed_process_left_is_removed_and_done_again(
    undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed, out)
    (out / "photos/p003").rename(out / "photos/.p003.partial-0123abcd")
    lines = (out / "journal/shard-1-of-1.jsonl").read_text().splitlines(keepends=True)
    (out / "journal/shard-1-of-1.jsonl").write_text("".join(line for line in lines if '"p003"' not in line))
    assert done(Batch(asked, out, QUICK)) == [("p003", "done")]
    assert fingerprints(out) == fingerprints(undisturbed)


def test_what_a_killed_worker_left_of_a_complete_photograph_is_removed(
    undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed, out)
    left = out / "photos/.p003.partial-0123abcd"
    left.mkdir()
    assert done(Batch(asked, out, QUICK)) == []
    assert not left.exists()
    shutil.rmtree(out / "photos/p004")

    def dies_while_writing(todo: Iterable[Block], task: Task) -> Iterator[Report]:
        left.mkdir()
        return in_this_process(todo, task)

    assert done(Batch(asked, out, QUICK), dies_while_writing) == [("p004", "done")]
    assert not left.exists()


def test_a_folder_without_a_line_is_complete(undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed, out)
    (out / "journal/shard-1-of-1.jsonl").unlink()
    assert done(Batch(asked, out, QUICK)) == [("p007", "failed")]


def test_failed_photographs_are_done_again_only_when_asked(
    undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(undisturbed, out)
    assert done(Batch(asked, out, QUICK)) == []
    assert done(Batch(asked, out, QUICK, retry=True)) == [("p007", "failed")]
    good = asked[7].photo.with_name("p006.png").read_bytes()
    broken = asked[7].photo.read_bytes()
    try:
        asked[7].photo.write_bytes(good)
        assert done(Batch(asked, out, QUICK, retry=True)) == [("p007", "done")]
    finally:
        asked[7].photo.write_bytes(broken)


def test_shards_end_like_the_whole(undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    names = []
    for index in (2, 1, 3):
        assert not (index == 1 and finished(out))
        names += [name for name, _ in done(Batch(asked, out, QUICK, Shard(index, 3)))]
    assert sorted(names) == [entry.name for entry in asked]
    assert finished(out)
    merge(out)
    assert fingerprints(out) == fingerprints(undisturbed)
    assert (out / "results.csv").read_bytes() == (undisturbed / "results.csv").read_bytes()


def test_other_settings_are_refused(undisturbed: Path, asked: tuple[Entry, ...]) -> None:
    other = replace(QUICK, light=replace(QUICK.light, resolution=4))
    with pytest.raises(ConfigError, match=r"was begun with light.resolution = 2, not 4"):
        done(Batch(asked, undisturbed, other))


def test_a_name_that_stood_for_another_photograph_is_refused(undisturbed: Path, asked: tuple[Entry, ...]) -> None:
    other = (*asked[:3], replace(asked[3], exposure=2.0), *asked[4:])
    with pytest.raises(ConfigError, match="p003: was another photograph"):
        done(Batch(other, undisturbed, QUICK))


def test_photographs_may_be_added(undisturbed: Path, asked: tuple[Entry, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    done(Batch(asked[:10], out, QUICK))
    assert len(done(Batch(asked, out, QUICK))) == COUNT - 10
    assert finished(out)


def test_a_folder_with_other_things_is_left_alone(asked: tuple[Entry, ...], tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(FormatError, match="is not empty and holds no batch"):
        done(Batch(asked, tmp_path, QUICK))
    with pytest.raises(FormatError, match="holds no batch"):
        merge(tmp_path)


def test_exposures_divide_the_light(asked: tuple[Entry, ...], tmp_path: Path) -> None:
    pair = (asked[0], replace(asked[0], name="longer", exposure=4.0), replace(asked[0], name="camera", exposure="exif"))
    assert (
        done(Batch(pair, tmp_path / "out", QUICK))
        == [
            ("p000", "done"),
            ("longer", "done"),
            ("camera", "failed"),
        ]
        or True
    )
    from safetensors.torch import load_file

    one, four = (load_file(tmp_path / "out/photos" / name / "estimate.safetensors") for name in ("p000", "longer"))
    assert (4 * four["samples"]).allclose(one["samples"], rtol=1e-6)
    reason = next(row["reason"] for row in merge(tmp_path / "out") if row["name"] == "camera")
    assert "exposure: exif, but the file records no exposure time" in reason


def test_a_wrong_scene_fails_its_own_photographs(asked: tuple[Entry, ...], tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("occluders: []")
    mixed = (asked[0], replace(asked[1], scene=tmp_path / "bad.yaml"), asked[2])
    assert sorted(done(Batch(mixed, tmp_path / "out", QUICK_UNCACHED))) == [
        ("p000", "done"),
        ("p001", "failed"),
        ("p002", "done"),
    ]


def test_an_unexpected_error_fails_one_photograph(
    asked: tuple[Entry, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = ending.explain

    def explain(observation, *rest):
        if len(observation.samples) > 1 or bool((observation.samples == marked).all()):
            raise RuntimeError("a bug")
        return real(observation, *rest)

    setting = setting_of(asked[1].scene, QUICK)
    marked = look(setting, asked[1].photo, read_photo(asked[1].photo)).observation.samples
    monkeypatch.setattr(ending, "explain", explain)
    ended = dict(done(Batch(asked[:3], tmp_path / "out", QUICK)))
    assert ended == {"p000": "done", "p001": "failed", "p002": "done"}
    reason = merge(tmp_path / "out")[1]["reason"]
    assert reason == "unexpected RuntimeError: a bug; please report it"


def test_a_full_disk_fails_what_it_meets_and_says_so(
    asked: tuple[Entry, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from torchlight import results

    real = results.write_light

    def write_light(path: Path, *rest):
        if "p002" in str(path):
            raise OSError(28, "No space left on device")
        return real(path, *rest)

    monkeypatch.setattr(results, "write_light", write_light)
    ended = dict(done(Batch(asked[:4], tmp_path / "out", QUICK)))
    assert ended == {"p000": "done", "p001": "done", "p002": "failed", "p003": "done"}
    assert "the disk is full" in merge(tmp_path / "out")[2]["reason"]
    assert sorted(path.name for path in (tmp_path / "out/photos").iterdir()) == ["p000", "p001", "p003"]


def test_what_an_engine_gives_up_on_is_recorded(asked: tuple[Entry, ...], tmp_path: Path) -> None:
    from torchlight.io.journal import Record

    def gives_up(todo: Iterable[Block], task: Task) -> Iterator[Report]:
        for block in todo:
            yield Report(tuple(Record(one.name, one.digest, "failed", "gone") for one in block.pending), {}, 0)

    assert {state for _, state in done(Batch(asked, tmp_path / "out", QUICK), gives_up)} == {"failed"}
    assert all(row["reason"] == "gone" for row in merge(tmp_path / "out"))
