"""Reading a file's bytes, with one-line reasons when that is not possible."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from torchlight.errors import FormatError

MAX_BYTES = 4 * 2**30
MAX_PIXELS = 400_000_000
# deflate shrinks by at most 1032 and a byte holds eight pixels of one bit; no other format of photographs comes near
PIXELS_PER_BYTE = 8 * 1032
FEW_PIXELS = 1 << 24  # so many are decoded whatever the file's size


def read_bytes(path: str | Path, limit: int = MAX_BYTES) -> bytes:
    """Returns the whole file.

    Args:
        path: the file.
        limit: largest accepted size in bytes; larger files are refused before they are read.

    Raises:
        FormatError: missing, a folder, not a regular file, empty, larger than `limit` or unreadable.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise FormatError(f"{path}: expected a file, got a folder; name the file inside it")
        status = path.stat()
        size = status.st_size
        if not stat.S_ISREG(status.st_mode):  # a device or a pipe may never end
            raise FormatError(f"{path}: not a regular file; copy its content to one")
        if size > limit:
            raise FormatError(f"{path}: {size:,} bytes is more than the limit of {limit:,}; use a smaller file")
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise FormatError(f"{path}: no such file; check the name and the folder") from error
    except FormatError:
        raise
    except (OSError, ValueError) as error:
        raise FormatError(f"{one_line(str(path))}: cannot be read: {reason(error)}") from error
    if not data:
        raise FormatError(f"{path}: the file is empty; write it again")
    return data


def check_size(width: int, height: int, size: int, name: str, channels: int = 1) -> None:
    """Raises FormatError for a picture that is empty, too large, or larger than its file can hold, before it is made.

    Args:
        width: as the header says.
        height: likewise.
        size: of the file in bytes.
        name: what the error calls the file.
        channels: that are decoded one by one.
    """
    pixels = width * height
    if width < 1 or height < 1 or pixels > MAX_PIXELS:
        raise FormatError(f"{name}: {width} x {height} pixels; expected 1 to {MAX_PIXELS:,} pixels")
    if pixels * channels > max(FEW_PIXELS, PIXELS_PER_BYTE * size):
        raise FormatError(f"{name}: {width} x {height} pixels cannot lie in {size:,} bytes; copy or save it again")


def sha256_of(data: bytes) -> str:
    """Returns the SHA-256 of the bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def reason(error: BaseException) -> str:
    """Returns what an exception says, on one line; an OSError without its number and path."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return one_line(text) or type(error).__name__


def one_line(text: str, limit: int = 200) -> str:
    """Returns the text with all white space and control characters as single spaces, shortened to `limit`."""
    printable = "".join(character if character.isprintable() else " " for character in text)
    flat = " ".join(printable.split())
    return flat if len(flat) <= limit else flat[: limit - 3] + "..."
