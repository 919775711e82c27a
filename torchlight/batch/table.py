"""A line per photograph: what it was, how it ended, and the figures that one sorts and filters by."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlight.batch.work import complete, folder_of
from torchlight.errors import FormatError
from torchlight.io.batch_folder import JOURNAL, read_object, write_lines, write_table
from torchlight.io.journal import Record, records
from torchlight.io.manifest import Entry
from torchlight.io.parquet import Kind, write_parquet

FIGURES: Mapping[str, Kind] = {
    "rms_255": "float64",
    "rms_relative": "float64",
    "visible": "int64",
    "points": "int64",
    "visible_share": "float64",
    "method": "string",
    "resolution": "int64",
    "solver": "string",
    "peak_share": "float64",
}
COLUMNS: Mapping[str, Kind] = {
    **dict.fromkeys(("name", "photo", "scene", "state", "reason"), "string"),
    "warnings": "int64",
    **FIGURES,
    "functions": "int64",
    "peak_azimuth_degrees": "float64",
    "peak_elevation_degrees": "float64",
    "near": "bool",
    "drift_degrees": "float64",
}
PARQUET, TAG = "results.parquet", "tag."


def write_tables(out: Path, entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Writes results.jsonl and results.csv, and returns their rows, in the manifest's order."""
    rows = list(table(out, entries))
    write_lines(out / "results.jsonl", rows)
    write_table(out / "results.csv", rows)
    return rows


def write_typed_table(out: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes results.parquet: the rows of `write_tables`, every column of one type whatever the rows hold.

    Tags are texts.

    Raises:
        ConfigError: pyarrow is not installed.
        FormatError: the file cannot be written.
    """
    tags = dict.fromkeys(key for row in rows for key in row if key.startswith(TAG))
    write_parquet(out / PARQUET, rows, {**COLUMNS, **dict.fromkeys(tags, "string")})


def table(out: Path, entries: Sequence[Entry]) -> Iterator[dict[str, Any]]:
    """Yields the row of every photograph: done, failed (with the reason) or pending.

    A row holds name, photo, scene, state and reason; of what is done also the number of warnings, `FIGURES`, functions
    (of all channels), azimuth and elevation of the strongest peak in degrees, whether the light is near and by how much
    it drifts in degrees; and a column "tag.<key>" per tag.
    """
    ended = records(out / JOURNAL)
    for entry in entries:
        record = ended.get(entry.name)
        known = {"name": entry.name, "photo": str(entry.photo), "scene": str(entry.scene)}
        tags = {f"{TAG}{key}": value for key, value in entry.tags}
        if complete(out, entry.name):
            found, reason = figures(out, entry.name)
            state = "failed" if reason else "done"
        else:
            state = "failed" if record is not None and record.state == "failed" else "pending"
            found, reason = {}, record.reason if record is not None and state == "failed" else ""
        yield {**known, "state": state, "reason": reason, **found, **tags}


def figures(out: Path, name: str) -> tuple[dict[str, Any], str]:
    """Returns the figures of a finished photograph, or why they cannot be read."""
    try:
        result = read_object(folder_of(out, name) / "result.json")
    except FormatError as error:
        return {}, str(error)
    near = result.get("near_light") or {}
    functions = result.get("functions")
    return {
        "warnings": len(result.get("warnings", [])),
        **{key: result.get(key) for key in FIGURES},
        "functions": sum(functions) if functions else None,
        **direction(result.get("peak_direction")),
        "near": near.get("near"),
        "drift_degrees": near.get("drift_degrees"),
    }, ""


def direction(peak: Sequence[float] | None) -> dict[str, float | None]:
    """Returns azimuth (from +x towards +y) and elevation of a direction in degrees."""
    if peak is None:
        return {"peak_azimuth_degrees": None, "peak_elevation_degrees": None}
    x, y, z = peak
    return {
        "peak_azimuth_degrees": round(math.degrees(math.atan2(y, x)), 3),
        "peak_elevation_degrees": round(math.degrees(math.atan2(z, math.hypot(x, y))), 3),
    }


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Returns how many photographs are done, failed and pending."""
    return {state: sum(row["state"] == state for row in rows) for state in ("done", "failed", "pending")}


def reasons(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, int]]:
    """Returns why photographs failed and how many did so, the commonest first; photographs' names are left out."""
    said = Counter(without_name(row["reason"], row["photo"]) for row in rows if row["state"] == "failed")
    return said.most_common()


def without_name(reason: str, photo: str) -> str:
    """Returns a reason without the photograph that it begins with, so that those of many can be counted."""
    _, named, rest = reason.partition(Path(photo).name)
    return rest.lstrip(": ") or reason if named else reason


def record_of_complete(entry: Entry) -> Record:
    """Returns the record of a photograph whose folder was complete before its line could be written."""
    return Record(entry.name, entry.digest, "done")
