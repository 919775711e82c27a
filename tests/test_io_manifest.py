"""Manifests: what lines and patterns name, and what is said of a wrong one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from torchlight.errors import ConfigError, FormatError
from torchlight.io.manifest import EXIF, Entry, as_row, derived, read_entries


def manifest(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_a_line_of_json_names_everything(tmp_path: Path) -> None:
    line = {
        "photo": "a/1.jpg",
        "scene": "s.yaml",
        "mask": "m.png",
        "exposure": 0.5,
        "name": "first",
        "tags": {"k": "v"},
    }
    entries = read_entries([manifest(tmp_path, "m.jsonl", json.dumps(line) + "\n\n")], None)
    expected = Entry("first", tmp_path / "a/1.jpg", tmp_path / "s.yaml", tmp_path / "m.png", 0.5, (("k", "v"),))
    assert entries == [expected]


def test_a_table_says_the_same_as_json(tmp_path: Path) -> None:
    rows = [
        {"photo": "a/1.jpg", "scene": "s.yaml", "exposure": "exif", "tags": {"sky": "clear", "hour": "9"}},
        {"photo": "b/1.jpg", "scene": "s.yaml", "mask": "m.png", "exposure": 2.0, "name": "x/y"},
    ]
    table = "photo,scene,mask,exposure,name,tags\na/1.jpg,s.yaml,,exif,,sky=clear;hour=9\nb/1.jpg,s.yaml,m.png,2,x/y,\n"
    as_json = read_entries([manifest(tmp_path, "m.jsonl", "\n".join(map(json.dumps, rows)))], None)
    assert read_entries([manifest(tmp_path, "m.csv", table)], None) == as_json
    assert as_json[0].exposure == EXIF
    assert [entry.name for entry in as_json] == ["a/1", "x/y"]


def test_the_scene_of_the_call_is_that_of_lines_without_one(tmp_path: Path) -> None:
    path = manifest(tmp_path, "m.csv", "photo,scene\n1.png,\n2.png,own.yaml\n")
    assert [entry.scene for entry in read_entries([path], Path("s.yaml"))] == [Path("s.yaml"), tmp_path / "own.yaml"]


def test_a_pattern_names_its_files_in_order_by_their_place_under_it(tmp_path: Path) -> None:
    touch(tmp_path, "b/2.jpg", "a/2.jpg", "a/1.jpg", "a/notes.txt")
    entries = read_entries([str(tmp_path / "*" / "*.jpg")], Path("s.yaml"))
    assert [entry.name for entry in entries] == ["a/1", "a/2", "b/2"]
    touch(tmp_path, "c/0.jpg")
    more = read_entries([str(tmp_path / "*" / "*.jpg")], Path("s.yaml"))
    assert set(entries) < set(more)


def test_names_do_not_depend_on_which_photographs_a_folder_holds(tmp_path: Path) -> None:
    lines = ['{"photo": "day1/a.jpg"}', '{"photo": "day1/b.jpg"}']
    path = manifest(tmp_path, "m.jsonl", "\n".join(lines))
    assert [entry.name for entry in read_entries([path], Path("s"))] == ["day1/a", "day1/b"]


def test_photographs_outside_the_manifests_folder_have_names_too(tmp_path: Path) -> None:
    (tmp_path / "lists").mkdir()
    path = manifest(tmp_path / "lists", "m.jsonl", '{"photo": "../p/1.jpg"}')
    assert [entry.name for entry in read_entries([path], Path("s"))] == ["p/1"]


def test_an_entry_read_again_is_the_same(tmp_path: Path) -> None:
    entry = Entry("a/b", tmp_path / "1.jpg", tmp_path / "s.yaml", tmp_path / "m.png", EXIF, (("k", "v"),))
    again = read_entries([manifest(tmp_path, "m.jsonl", json.dumps(as_row(entry)))], None)
    assert again == [entry]
    assert again[0].digest == entry.digest


@pytest.mark.parametrize("change", [{"photo": Path("2")}, {"scene": Path("2")}, {"mask": Path("2")}, {"exposure": 2.0}])
def test_the_digest_tells_entries_apart(change: dict) -> None:
    from dataclasses import replace

    entry = Entry("a", Path("1"), Path("1"), Path("1"), 1.0)
    assert replace(entry, **change).digest != entry.digest
    assert replace(entry, name="b", tags=(("k", "v"),)).digest == entry.digest


@pytest.mark.parametrize(
    ("part", "name"),
    [
        (".hidden.jpg", "_hidden"),
        ("a:b\\c.jpg", "a_b_c"),
        ("line\nbreak.jpg", "line_break"),
        ("\u202egpj.exe.jpg", "_gpj.exe"),
    ],
)
def test_a_name_from_a_file_is_safe(part: str, name: str) -> None:
    assert derived(Path("/base") / part, Path("/base")) == name


def test_a_long_name_is_cut_and_stays_its_own() -> None:
    long = [derived(Path("/base") / ("x" * 240 + end + ".jpg"), Path("/base")) for end in "ab"]
    assert all(len(name.encode()) <= 200 for name in long)
    assert long[0] != long[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "m.jsonl, line 1: not JSON"),
        ('{"photo": "1"}\n[1]', "m.jsonl, line 2: expected a mapping"),
        ('{"photo": "1", "photo": "2"}', "the key 'photo' appears twice"),
        ('{"photos": "1"}', "m.jsonl, line 1: photos: unknown key; did you mean 'photo'?"),
        ("{}", "line 1: photo: missing"),
        ('{"photo": 3}', "line 1: photo: expected text, got 3"),
        ('{"photo": "1", "exposure": 0}', "line 1: exposure: expected a number above 0"),
        ('{"photo": "1", "exposure": "exi"}', "line 1: exposure: expected a number above 0 or exif, got 'exi'"),
        ('{"photo": "1", "exposure": NaN}', "line 1: exposure: expected a finite number"),
        ('{"photo": "1", "tags": {"a": 1}}', "line 1: tags: expected a mapping of texts"),
        ('{"photo": "1", "name": "../x"}', "line 1: name: '../x' would not lie inside the output"),
        ('{"photo": "1", "name": "/x"}', "would not lie inside the output"),
        ('{"photo": "1", "name": "a//x"}', "would not lie inside the output"),
        ('{"photo": "1", "name": ".x"}', "would not lie inside the output"),
        ('{"photo": "1", "name": "a\\u0000"}', "cannot name a folder"),
        ('{"photo": "a.jpg"}\n{"photo": "a.png"}', "would both be written to a;"),
        ('{"photo": "a.jpg"}\n{"photo": "A.png"}', "would both be written to A;"),
        ('{"photo": "1", "name": "a"}\n{"photo": "2", "name": "a/b"}', "a/b would be written inside the folder of a"),
        ("", "is empty"),
        ("\n", "no photograph given"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises((ConfigError, FormatError)) as raised:
        read_entries([manifest(tmp_path, "m.jsonl", text)], Path("s.yaml"))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("photo,photo\n1,2\n", "line 1: a column appears twice"),
        ("photo,scene\n1\n", "m.csv, line 2: 1 cells, but the first line names 2 columns"),
        ("photo,lamp\n1,2\n", "line 2: lamp: unknown key"),
        ('photo\n"1\n', "not CSV"),
        ("photo,exposure\n1,bright\n", "line 2: exposure: expected a number above 0 or exif, got 'bright'"),
    ],
)
def test_a_wrong_row_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises((ConfigError, FormatError)) as raised:
        read_entries([manifest(tmp_path, "m.csv", text)], Path("s.yaml"))
    assert said in str(raised.value)


def test_a_manifest_that_is_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_bytes(b"\xff\xfe\x00photo")
    with pytest.raises(FormatError, match="not a text file"):
        read_entries([str(tmp_path / "m.csv")], Path("s"))


def test_without_a_scene_nothing_starts(tmp_path: Path) -> None:
    touch(tmp_path, "1.jpg")
    with pytest.raises(ConfigError, match="no scene given"):
        read_entries([str(tmp_path / "1.jpg")], None)
    with pytest.raises(ConfigError, match="names no scene"):
        read_entries([manifest(tmp_path, "m.jsonl", '{"photo": "1.jpg"}')], None)


def test_a_folder_and_a_pattern_without_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"is a folder; name its photographs, for example '.*/\*\.jpg'"):
        read_entries([str(tmp_path)], Path("s"))
    with pytest.raises(FormatError, match="matches no file"):
        read_entries([str(tmp_path / "*.jpg")], Path("s"))
    with pytest.raises(ConfigError, match="a manifest stands alone"):
        read_entries([str(tmp_path / "a.csv"), str(tmp_path / "1.jpg")], Path("s"))


def test_a_file_whose_name_looks_like_a_pattern_is_itself(tmp_path: Path) -> None:
    touch(tmp_path, "a[1].jpg")
    assert [entry.name for entry in read_entries([str(tmp_path / "a[1].jpg")], Path("s"))] == ["a[1]"]
