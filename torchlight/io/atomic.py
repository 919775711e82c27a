"""Files and folders that appear whole or not at all.

Everything is written under a temporary name beside its destination and renamed when complete. A crash, a full
disk or Ctrl-C leaves the destination as it was; the temporary name is removed whenever Python still runs.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from torchlight.errors import FormatError
from torchlight.io.files import reason

PARTIAL = ".partial-"
FLUSHED_TOGETHER = 8


def write_atomically(path: str | Path, data: bytes) -> None:
    """Writes `data` so that `path` is either as it was or complete.

    Raises:
        FormatError: the folder is missing or not writable, the disk is full, or `path` is not a regular file.
    """
    with partial_file(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def partial_file(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path in the same folder that becomes `path` when the block ends without an error.

    Raises:
        FormatError: as `write_atomically`; also for an OSError raised inside the block.
    """
    target = _regular_target(Path(path))
    temporary = _partial_name(target)
    try:
        yield temporary
        if PARTIAL not in target.parent.name:  # else with all of its folder: `_flush_all`
            _flush(temporary)
        os.replace(temporary, target)  # noqa: PTH105 (tests interpose on os.replace)
    except FormatError:
        raise
    except OSError as error:
        raise _write_error(target, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def partial_folder(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yields a temporary folder beside `path` that becomes `path` when the block ends without an error.

    Parents are created. With `overwrite`, an existing folder is first set aside under a hidden name, then removed
    once the new one is in place, and put back if that fails: at no moment are both the old and the new one gone.

    Raises:
        FormatError: `path` exists and `overwrite` is False, the place is not writable, or the disk is full.
    """
    target = Path(path)
    _check_folder_target(target, overwrite)
    temporary = _partial_name(target)
    try:
        temporary.mkdir(parents=True)
        yield temporary
        _flush_all(temporary)
        _install_folder(temporary, target)
    except FormatError:
        raise
    except OSError as error:
        raise _write_error(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_writable(folder: str | Path) -> None:
    """Raises FormatError unless a folder is there and writable, or can be made; makes nothing."""
    folder = Path(folder)
    place = next((parent for parent in (folder, *folder.absolute().parents) if os.path.lexists(parent)), folder)
    if not place.is_dir():
        raise FormatError(f"{folder}: cannot be a folder: {place} exists and is not one; choose another place")
    if not os.access(place, os.W_OK | os.X_OK):
        raise FormatError(f"{folder}: cannot be written: no permission in {place}; choose another place")


def make_folder(folder: str | Path) -> None:
    """Makes a folder and its parents where they are missing; raises FormatError where that is not possible."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _write_error(Path(folder), error) from error


def _check_folder_target(target: Path, overwrite: bool) -> None:
    if not os.path.lexists(target):
        return
    if not target.is_dir() or target.is_symlink():
        raise FormatError(f"{target}: exists and is not a folder; remove it or choose another place")
    if not overwrite:
        raise FormatError(f"{target}: already exists; pass --overwrite to replace it or choose another place")


def _install_folder(temporary: Path, target: Path) -> None:
    if not target.exists():
        os.replace(temporary, target)  # noqa: PTH105
        return
    aside = target.with_name(f".{target.name}.old-{secrets.token_hex(4)}")
    os.replace(target, aside)  # noqa: PTH105
    try:
        os.replace(temporary, target)  # noqa: PTH105
    except BaseException:
        os.replace(aside, target)  # noqa: PTH105
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _regular_target(path: Path) -> Path:
    """Returns the path with links followed; a device or pipe must not be replaced by a file."""
    try:
        target = path.resolve()
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "not a regular file"
            raise FormatError(f"{path}: is {kind}; name a file to write")
    except FormatError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise FormatError(f"{path}: cannot be written: {reason(error)}; choose another place") from error
    return target


def _partial_name(target: Path) -> Path:
    return target.with_name(f".{target.name}{PARTIAL}{secrets.token_hex(4)}")


def _flush(path: Path) -> None:
    """Forces the file to the disk: a rename may otherwise survive a crash that its contents do not."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_all(folder: Path) -> None:
    """Forces all files of a folder to the disk, side by side: waiting for one after the other takes as many times."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    with ThreadPoolExecutor(FLUSHED_TOGETHER) as pool:
        list(pool.map(_flush, files))


def _write_error(target: Path, error: OSError) -> FormatError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return FormatError(f"{target}: cannot be written: the disk is full; free some space or choose another place")
    return FormatError(f"{target}: cannot be written: {reason(error)}; choose a place that exists and is writable")
