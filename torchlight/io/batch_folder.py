"""The files of a batch's output beside its photographs' folders.

OUT/batch.json            what was asked: configuration, versions
OUT/manifest.jsonl        its photographs, in order
OUT/journal/              how each ended, a file per shard
OUT/photos/<name>/        a folder per photograph
OUT/results.jsonl, .csv   a line per photograph, when the batch has ended or is merged
OUT/report.html           the same to look at
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlight.errors import FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.files import one_line, read_bytes

BATCH, MANIFEST, JOURNAL, PHOTOS = "batch.json", "manifest.jsonl", "journal", "photos"


def read_object(path: Path) -> dict[str, Any]:
    """Returns the mapping that a JSON file holds; raises FormatError where it holds none."""
    try:
        content = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: not JSON: {one_line(str(error))}; it was changed by hand?") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path}: expected a JSON object; it was changed by hand?")
    return content


def write_object(path: Path, content: Mapping[str, Any]) -> None:
    """Writes a mapping as JSON, complete or not at all."""
    write_atomically(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def write_lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Writes mappings as JSON, one per line, complete or not at all."""
    write_atomically(path, "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode())


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes mappings as CSV, complete or not at all; columns in the order in which they first occur.

    Bytes of a file's name that are no UTF-8 are written as \\udcff.
    """
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(errors="backslashreplace"))
