from __future__ import annotations

import errno
import hashlib
import multiprocessing
import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, TorchlightWarning
from torchlight.io import cache

KEY = "a" * 64
OTHER = "b" * 64


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(cache.FOLDER_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv(cache.LIMIT_VARIABLE, raising=False)
    return tmp_path / "cache"


def tensors() -> dict[str, Tensor]:
    return {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor([True, False]), "c": torch.zeros(0, 4).double()}


def file_of(folder: Path, key: str = KEY) -> Path:
    return folder / f"{key}.safetensors"


def test_round_trip(folder: Path) -> None:
    assert cache.load(KEY) is None
    assert cache.store(KEY, tensors(), {"note": "x"})
    found = cache.load(KEY)
    assert found is not None
    assert found.keys() == tensors().keys()
    for name, tensor in tensors().items():
        assert_close(found[name], tensor, rtol=0, atol=0)
    assert [entry.name for entry in folder.iterdir()] == [f"{KEY}.safetensors"]


def test_views_and_shared_memory() -> None:
    base = torch.arange(12.0).reshape(3, 4)
    assert cache.store(KEY, {"base": base, "turned": base.T, "row": base[1]}, {})
    found = cache.load(KEY)
    assert found is not None
    assert_close(found["turned"], base.T, rtol=0, atol=0)
    assert_close(found["row"], base[1], rtol=0, atol=0)


@pytest.mark.parametrize("damage", ["empty", "text", "truncated", "flipped", "header"])
def test_damaged_files_are_not_trusted(folder: Path, damage: str) -> None:
    cache.store(KEY, tensors(), {})
    path = file_of(folder)
    data = path.read_bytes()
    position = data.index(torch.arange(6.0).numpy().tobytes()) + 10
    path.write_bytes(
        {
            "empty": b"",
            "text": b"this is not a safetensors file",
            "truncated": data[:-3],
            "flipped": data[:position] + bytes([data[position] ^ 1]) + data[position + 1 :],
            "header": b"\xff" * 8 + data[8:],
        }[damage]
    )
    with pytest.warns(TorchlightWarning, match="ignored and computed again") as record:
        assert cache.load(KEY) is None
    assert str(path) in str(record[0].message)
    assert "\n" not in str(record[0].message)
    assert cache.store(KEY, tensors(), {})
    assert cache.load(KEY) is not None


def test_foreign_files_are_not_trusted(folder: Path) -> None:
    cache.store(OTHER, tensors(), {})
    os.replace(file_of(folder, OTHER), file_of(folder))  # noqa: PTH105
    with pytest.warns(TorchlightWarning, match="not written for this key"):
        assert cache.load(KEY) is None
    save_file(tensors(), file_of(folder))
    with pytest.warns(TorchlightWarning, match="not written for this key"):
        assert cache.load(KEY) is None
    save_file(tensors(), file_of(folder), metadata={"key": KEY})
    with pytest.warns(TorchlightWarning, match="checksum does not match"):
        assert cache.load(KEY) is None


def test_unwritable_folder_costs_only_a_warning(folder: Path) -> None:
    folder.write_bytes(b"a file in place of the folder")
    with pytest.warns(TorchlightWarning, match=f"not cached: .*{cache.FOLDER_VARIABLE}") as record:
        assert not cache.store(KEY, tensors(), {})
    assert "\n" not in str(record[0].message)
    assert cache.load(KEY) is None
    assert cache.entries() == ()
    assert cache.clear() == 0


def test_full_disk_costs_only_a_warning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.warns(TorchlightWarning, match="the disk is full"):
        assert not cache.store(KEY, tensors(), {})
    assert list(folder.iterdir()) == []


def test_least_recently_used_goes_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [digit * 64 for digit in "0123"]
    for age, key in enumerate(keys[:3]):
        cache.store(key, tensors(), {})
        os.utime(file_of(folder, key), (1000 + age, 1000 + age))
    cache.load(keys[0])
    size = file_of(folder, keys[0]).stat().st_size
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(3 * size))
    cache.store(keys[3], tensors(), {})
    assert {entry.key for entry in cache.entries()} == {keys[0], keys[2], keys[3]}
    for entry in cache.entries():
        os.utime(file_of(folder, entry.key), (4e9, 4e9))
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(size))
    assert cache.store(KEY, tensors(), {})
    assert [entry.key for entry in cache.entries()] == [KEY]
    monkeypatch.setenv(cache.LIMIT_VARIABLE, str(size - 1))
    with pytest.warns(TorchlightWarning, match="not cached: .*TORCHLIGHT_CACHE_LIMIT"):
        assert not cache.store(OTHER, tensors(), {})
    assert [entry.key for entry in cache.entries()] == [KEY]


@pytest.mark.parametrize("value", ["many", "-1", "1e9"])
def test_limit_must_be_a_number_of_bytes(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv(cache.LIMIT_VARIABLE, value)
    with pytest.raises(ConfigError, match=f"TORCHLIGHT_CACHE_LIMIT: expected a number of bytes .* got '{value}'"):
        cache.size_limit()


def test_list_and_clear(folder: Path) -> None:
    cache.store(KEY, tensors(), {})
    cache.store(OTHER, tensors(), {})
    os.utime(file_of(folder), (1000, 1000))
    (folder / "notes.txt").write_text("mine")
    (folder / ".x.partial-0000").write_text("left by a crash")
    os.utime(folder / ".x.partial-0000", (1000, 1000))
    (folder / ".y.partial-0000").write_text("being written")
    size = file_of(folder).stat().st_size
    assert [(entry.key, entry.size) for entry in cache.entries()] == [(OTHER, size), (KEY, size)]
    assert cache.entries()[1].last_used == 1000
    assert cache.clear() == 2 * size + len("left by a crash")
    assert sorted(entry.name for entry in folder.iterdir()) == [".y.partial-0000", "notes.txt"]


def test_where_it_lies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(cache.FOLDER_VARIABLE)
    monkeypatch.setattr(cache.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.cache_folder() == tmp_path / "torchlight"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache.cache_folder() == Path("~/.cache/torchlight").expanduser()


@pytest.mark.parametrize("key", ["", "abc", "../" + "a" * 61, "A" * 64])
def test_keys_that_are_no_keys(key: str) -> None:
    for call in (lambda: cache.load(key), lambda: cache.store(key, {}, {})):
        with pytest.raises(ConfigError, match="cache key: expected 64 hexadecimal digits"):
            call()


def _store_often(value: float) -> None:
    for _ in range(30):
        cache.store(KEY, {"a": torch.full((20_000,), value)}, {})


def test_two_processes_write_the_same_key() -> None:
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_store_often, args=(value,)) for value in (1.0, 2.0)]
    for worker in workers:
        worker.start()
    seen = set()
    while any(worker.is_alive() for worker in workers):
        found = cache.load(KEY)
        if found is not None:
            seen.update(found["a"].unique().tolist())
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0
    assert seen <= {1.0, 2.0}
    assert cache.load(KEY) is not None
    assert len(cache.entries()) == 1


def test_content_key_is_stable() -> None:
    parts = {"a": torch.arange(3, dtype=torch.int32), "b": "text", "c": (1, 2.5, None, ("x",)), "d": True}
    assert cache.content_key(parts) == cache.content_key(dict(reversed(parts.items())))
    expected = hashlib.sha256(b"name:1:a" + b"str:1:b").hexdigest()
    assert cache.content_key({"a": "b"}) == expected
    expected = hashlib.sha256(b"name:1:t" + b"tensor torch.int16 [2]:4:" + bytes([1, 0, 2, 0])).hexdigest()
    assert cache.content_key({"t": torch.tensor([1, 2], dtype=torch.int16)}) == expected


def test_everything_matters_for_the_content_key() -> None:
    tensor = torch.arange(6, dtype=torch.float32)
    parts: list[dict[str, cache.Part]] = [
        {},
        {"a": 1},
        {"b": 1},
        {"a": 1.0},
        {"a": True},
        {"a": "1"},
        {"a": None},
        {"a": (1,)},
        {"a": ()},
        {"a": ((1,),)},
        {"a": (1, "b")},
        {"a": ("1", "b")},
        {"a": 1, "b": 1},
        {"a": tensor},
        {"a": tensor.double()},
        {"a": tensor.reshape(2, 3)},
        {"a": tensor.reshape(3, 2)},
        {"a": tensor.reshape(2, 3).T},
        {"a": tensor.view(torch.int32)},
        {"a": torch.zeros(0)},
        {"a": torch.zeros(0, 3)},
        {"a": torch.tensor(1.0)},
        {"a": torch.tensor(-0.0)},
        {"a": torch.tensor(0.0)},
    ]
    keys = [cache.content_key(part) for part in parts]
    assert len(set(keys)) == len(keys)
    assert all(len(key) == 64 for key in keys)
    assert cache.content_key({"a": tensor.reshape(2, 3).T}) == cache.content_key(
        {"a": tensor.reshape(2, 3).T.contiguous()}
    )
    assert cache.content_key({"a": torch.ones(2, dtype=torch.bfloat16)}) != keys[0]
