from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from torchlight.errors import FormatError
from torchlight.io.atomic import partial_file, partial_folder, write_atomically


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def one_line(error: pytest.ExceptionInfo[FormatError], *parts: str) -> None:
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message, message


def test_write_creates_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_atomically(path, b"one")
    write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert names(tmp_path) == ["a.bin"]


def test_permissions_follow_the_umask(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"x")
    write_atomically(tmp_path / "atomic", b"x")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_atomically(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, step, full_disk)
    with pytest.raises(FormatError) as error:
        write_atomically(path, b"new")
    one_line(error, str(path), "the disk is full")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_full_disk_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(FormatError) as error:
        write_atomically(tmp_path / "a.bin", b"new")
    one_line(error, "a.bin", "the disk is full")
    assert names(tmp_path) == []


def test_interrupt_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with partial_file(tmp_path / "a.bin") as temporary:
            temporary.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(tmp_path) == []


def test_unwritable_places(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x")
    for path in (tmp_path / "file" / "a.bin", tmp_path / "none" / "a.bin"):
        with pytest.raises(FormatError) as error:
            write_atomically(path, b"x")
        one_line(error, str(path), "cannot be written")


def test_special_files_and_folders_are_not_replaced(tmp_path: Path) -> None:
    # a pipe of our own: a failing check must not cost the machine one of its devices
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, kind in (("pipe", "not a regular file"), ("folder", "a folder")):
        with pytest.raises(FormatError) as error:
            write_atomically(tmp_path / name, b"x")
        one_line(error, str(tmp_path / name), f"is {kind}; name a file to write")
    assert (tmp_path / "pipe").is_fifo()


def test_folder_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "out" / "photo"
    with partial_folder(target) as folder:
        write_atomically(folder / "light.exr", b"1")
        assert not target.exists()
        assert folder.parent == target.parent
    assert names(target) == ["light.exr"]
    assert names(tmp_path / "out") == ["photo"]


def test_folder_is_replaced_only_on_request(tmp_path: Path) -> None:
    target = tmp_path / "photo"
    target.mkdir()
    (target / "old").write_bytes(b"")
    with pytest.raises(FormatError) as error, partial_folder(target):
        pytest.fail("the block must not run")
    one_line(error, str(target), "--overwrite")
    with partial_folder(target, overwrite=True) as folder:
        (folder / "new").write_bytes(b"")
    assert names(target) == ["new"]
    assert names(tmp_path) == ["photo"]


def test_interrupt_keeps_the_old_folder(tmp_path: Path) -> None:
    target = tmp_path / "photo"
    target.mkdir()
    (target / "old").write_bytes(b"")

    def interrupted() -> None:
        with partial_folder(target, overwrite=True) as folder:
            (folder / "new").write_bytes(b"")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(target) == ["old"]
    assert names(tmp_path) == ["photo"]


def test_failed_swap_puts_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "photo"
    target.mkdir()
    (target / "old").write_bytes(b"")
    rename = os.replace
    calls = []

    def fails_second(source: Path, destination: Path) -> None:
        calls.append(source)
        if len(calls) == 2:
            full_disk()
        rename(source, destination)

    monkeypatch.setattr(os, "replace", fails_second)
    with pytest.raises(FormatError) as error, partial_folder(target, overwrite=True) as folder:
        (folder / "new").write_bytes(b"")
    one_line(error, str(target), "the disk is full")
    assert names(target) == ["old"]
    assert names(tmp_path) == ["photo"]


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "photo").write_bytes(b"")
    with pytest.raises(FormatError) as error, partial_folder(tmp_path / "photo", overwrite=True):
        pytest.fail("the block must not run")
    one_line(error, "photo", "not a folder")
    with pytest.raises(FormatError) as error, partial_folder(tmp_path / "photo" / "below"):
        pytest.fail("the block must not run")
    one_line(error, "photo", "cannot be written")
