"""report.html of a batch, from its folder alone: after the last photograph, and whenever shards are merged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlight.batch.table import reasons
from torchlight.batch.work import folder_of
from torchlight.errors import FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.batch_folder import BATCH, PHOTOS, read_object
from torchlight.io.files import read_bytes

REPORT, THUMBNAIL = "report.html", "thumbnail.jpg"
MOST_BYTES = 12 * 2**20  # of thumbnails in a page: some four thousand


def write_report(out: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes OUT/report.html of a batch's rows, unless its settings say that there shall be none.

    Raises:
        FormatError: the folder holds no batch, or cannot be written.
    """
    settings = read_object(out / BATCH).get("configuration")
    if isinstance(settings, Mapping) and settings.get("output.skip_report"):
        return
    from torchlight.report.batch_page import batch_page, chosen

    shown = [row["name"] for row in chosen(rows) if row["state"] == "done"]
    pictures = dict(thumbnails(out, shown))
    page = batch_page(
        f"{out.resolve().name}: lights from shadows", rows, reasons(rows), pictures, dict(links(out, shown))
    )
    write_atomically(out / REPORT, page)


def thumbnails(out: Path, names: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    """Yields the pictures of photographs by name, as many as fit into a page."""
    room = MOST_BYTES
    for name in names:
        path = folder_of(out, name) / THUMBNAIL
        if not path.is_file():
            continue
        try:
            data = read_bytes(path)
        except FormatError:  # a row without a picture is better than no report
            continue
        room -= len(data)
        if room < 0:
            return
        yield name, data


def links(out: Path, names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yields where to look for more of photographs: their reports, or else what their folders hold."""
    for name in names:
        last = REPORT if (folder_of(out, name) / REPORT).is_file() else "light.png"
        yield name, f"{PHOTOS}/{name}/{last}"
