"""A cache of tensors on disk: safetensors files, each named by the content it was computed from.

Nothing in it is trusted: a file's name, its own record of that name and a checksum of its tensors must agree, or it
is ignored with a warning. It is never needed: a folder that cannot be written costs a warning and time, no result.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import struct
import sys
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load as parse
from safetensors.torch import save
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, TorchlightWarning
from torchlight.io.atomic import PARTIAL, write_atomically
from torchlight.io.files import read_bytes, reason

FOLDER_VARIABLE = "TORCHLIGHT_CACHE"
LIMIT_VARIABLE = "TORCHLIGHT_CACHE_LIMIT"
DEFAULT_LIMIT = 8 * 2**30
_SUFFIX = ".safetensors"
_KEY = re.compile(r"[0-9a-f]{64}")
_STALE_SECONDS = 24 * 3600

Part = Tensor | str | int | float | None | tuple[object, ...]


@dataclass(frozen=True)
class Entry:
    """One cached file: its key, its size in bytes and when it was last used (seconds since the epoch)."""

    key: str
    size: int
    last_used: float


def content_key(parts: Mapping[str, Part]) -> str:
    """Returns the SHA-256 (64 hexadecimal digits) of named parts: names, types, dtypes, shapes and bytes.

    The order of the names does not matter. Values are taken bit by bit: 1, 1.0, True and "1" differ, as do float32
    and float64 tensors of the same values.
    """
    digest = hashlib.sha256()
    for name in sorted(parts):
        _feed(digest, "name", name.encode())
        _feed_part(digest, parts[name])
    return digest.hexdigest()


def cache_folder() -> Path:
    """Returns $TORCHLIGHT_CACHE, or the platform's folder for caches; it need not exist."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    if sys.platform == "darwin":
        return Path("~/Library/Caches/torchlight").expanduser()
    variable, default = (
        ("LOCALAPPDATA", "~/AppData/Local") if sys.platform == "win32" else ("XDG_CACHE_HOME", "~/.cache")
    )
    return Path(os.environ.get(variable) or default).expanduser() / "torchlight"


def size_limit() -> int:
    """Returns $TORCHLIGHT_CACHE_LIMIT in bytes, 8 GiB by default; raises ConfigError unless a whole number >= 0."""
    value = os.environ.get(LIMIT_VARIABLE)
    if not value:
        return DEFAULT_LIMIT
    if not value.isdecimal():
        raise ConfigError(f"{LIMIT_VARIABLE}: expected a number of bytes such as 8000000000, got '{value}'")
    return int(value)


def load(key: str) -> dict[str, Tensor] | None:
    """Returns the tensors stored under a key and marks them as used; None if there are none.

    A file that is damaged or does not belong to the key is ignored with a TorchlightWarning.
    """
    path = _path(key)
    if not path.is_file():
        return None
    try:
        tensors = _read_verified(path, key)
    except (SafetensorError, OSError, ValueError, RuntimeError) as error:
        _warn(f"{path}: ignored and computed again: {reason(error)}; 'torchlight cache clear' removes it")
        return None
    with suppress(OSError):
        os.utime(path)
    return tensors


def store(key: str, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> bool:
    """Stores tensors under a key, then removes the least recently used files above the size limit.

    Two processes may store the same key: each file appears whole, and the last one stays. Returns whether it was
    stored; if not (unwritable folder, full disk, larger than the limit) a TorchlightWarning says why.
    """
    path = _path(key)
    limit = size_limit()
    plain = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    data = save(plain, {**metadata, "key": key, "checksum": content_key(plain)})
    if len(data) > limit:
        _warn(
            f"not cached: {len(data):,} bytes are more than {LIMIT_VARIABLE} = {limit:,}; raise it to keep such results"
        )
        return False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, data)
    except (FormatError, OSError) as error:
        _warn(f"not cached: {path.parent}: {reason(error)}; set {FOLDER_VARIABLE} to a writable folder")
        return False
    _evict(limit, keep=key)
    return True


def entries() -> tuple[Entry, ...]:
    """Returns what the cache holds, most recently used first."""
    found = []
    for path in _files(f"*{_SUFFIX}"):
        if _KEY.fullmatch(path.stem):
            with suppress(OSError):
                status = path.stat()
                found.append(Entry(path.stem, status.st_size, status.st_mtime))
    return tuple(sorted(found, key=lambda entry: entry.last_used, reverse=True))


def clear() -> int:
    """Removes every cached file, and temporary ones that a crash left more than a day ago; returns the bytes freed."""
    freed = sum(entry.size for entry in entries() if _remove(entry))
    for path in _files(f".*{PARTIAL}*"):
        with suppress(OSError):
            status = path.stat()
            if status.st_mtime < time.time() - _STALE_SECONDS:
                path.unlink()
                freed += status.st_size
    return freed


def _evict(limit: int, keep: str) -> None:
    total = 0
    # the file just written comes first, whatever the clock's resolution
    for entry in sorted(entries(), key=lambda entry: (entry.key != keep, -entry.last_used)):
        total += entry.size
        if total > limit:
            _remove(entry)


def _remove(entry: Entry) -> bool:
    try:
        _path(entry.key).unlink()
    except OSError:
        return False
    return True


def _files(pattern: str) -> list[Path]:
    try:
        return list(cache_folder().glob(pattern))
    except OSError:
        return []


def _path(key: str) -> Path:
    if not _KEY.fullmatch(key):
        raise ConfigError(f"cache key: expected 64 hexadecimal digits from content_key, got '{key}'")
    return cache_folder() / f"{key}{_SUFFIX}"


def _read_verified(path: Path, key: str) -> dict[str, Tensor]:
    # read once: safe_open opens the file a second time for its tensors, and another process may replace it in between
    data = read_bytes(path)
    tensors = parse(data)
    (length,) = struct.unpack_from("<Q", data)
    metadata = json.loads(data[8 : 8 + length]).get("__metadata__", {})
    if metadata.get("key") != key:
        raise ValueError("it was not written for this key")
    if metadata.get("checksum") != content_key(tensors):
        raise ValueError("its checksum does not match")
    return tensors


def _feed(digest: hashlib._Hash, kind: str, payload: bytes | memoryview) -> None:
    """Adds a tagged, length-prefixed field, so that no two sequences of fields give the same bytes."""
    digest.update(f"{kind}:{len(payload)}:".encode())
    digest.update(payload)


def _feed_part(digest: hashlib._Hash, part: object) -> None:
    match part:
        case Tensor():
            data = part.detach().cpu().contiguous()
            _feed(digest, f"tensor {data.dtype} {list(data.shape)}", data.reshape(-1).view(torch.uint8).numpy().data)
        case tuple():
            _feed(digest, "tuple", str(len(part)).encode())
            for element in part:
                _feed_part(digest, element)
        case str():
            _feed(digest, "str", part.encode())
        case bool() | int() | None:
            _feed(digest, type(part).__name__, str(part).encode())
        case float():
            _feed(digest, "float", struct.pack("<d", part))
        case _:
            raise ConfigError(
                f"content_key: cannot hash a {type(part).__name__}; pass tensors, text, numbers or tuples"
            )


def _warn(message: str) -> None:
    warnings.warn(message, TorchlightWarning, stacklevel=3)
