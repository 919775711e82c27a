"""report.html of a batch: a line per photograph that may be sorted, with its picture and its light."""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from torchlight.report.markup import data_uri, document, listed, paragraph, section, text

MOST_ROWS = 5000
MOST_FAILURES = 500
STEP = 200  # rows that are laid out at first, and at each press of a button
MOST_TAGS = 8


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes:
        key: of the row.
        heading: over it.
        form: how a number is written; empty for text.
    """

    key: str
    heading: str
    form: str = ""


COLUMNS = (
    Column("rms_255", "error [of 255]", ".2f"),
    Column("visible", "samples", "d"),
    Column("functions", "functions, all channels", "d"),
    Column("peak_azimuth_degrees", "azimuth [deg]", ".1f"),
    Column("peak_elevation_degrees", "elevation [deg]", ".1f"),
    Column("peak_share", "its share", ".0%"),
    Column("near", "near light"),
    Column("warnings", "warnings", "d"),
)


def batch_page(
    title: str,
    rows: Sequence[Mapping[str, Any]],
    reasons: Sequence[tuple[str, int]],
    thumbnails: Mapping[str, bytes],
    links: Mapping[str, str],
) -> bytes:
    """Returns report.html of a batch; the same bytes for the same rows.

    Args:
        title: of the batch.
        rows: as results.jsonl holds them.
        reasons: why photographs failed, and how many did.
        thumbnails: JPEG files by photographs' names.
        links: where to look for more of a photograph, relative to the page, by name.
    """
    shown = chosen(rows)
    columns = [column for column in (*COLUMNS, *tags(rows)) if any(row.get(column.key) is not None for row in rows)]
    body = [
        f"<header><h1>{text(title)}</h1>",
        paragraph(summary(rows), "lead"),
        "</header><main>",
        failures(rows, reasons),
        section("all", "Photographs", *table(shown, len(rows), columns, thumbnails, links)),
        "</main>",
    ]
    return document(title, body, "table.js")


def chosen(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Returns the rows that a page holds, in their order: all, or what is not done first and then as many as fit."""
    if len(rows) <= MOST_ROWS:
        return list(rows)
    order = sorted(range(len(rows)), key=lambda index: (rows[index]["state"] == "done", index))
    return [rows[index] for index in sorted(order[:MOST_ROWS])]


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns how the batch ended, in a sentence or two."""
    count = {state: sum(row["state"] == state for row in rows) for state in ("done", "failed", "pending")}
    pending = f", {count['pending']} pending" if count["pending"] else ""
    errors = sorted(row["rms_255"] for row in rows if row.get("rms_255") is not None)
    told = ""
    if errors:
        told = f" Error, of 255: median {statistics.median(errors):.2f}, worst {errors[-1]:.2f}."
    return f"{count['done']} of {len(rows)} photographs done, {count['failed']} failed{pending}.{told}"


def failures(rows: Sequence[Mapping[str, Any]], reasons: Sequence[tuple[str, int]]) -> str:
    """Returns what failed and why; nothing where nothing did."""
    failed = [row for row in rows if row["state"] == "failed"]
    if not failed:
        return ""
    lines = [f"{row['name']}: {row['reason']}" for row in failed[:MOST_FAILURES]]
    more = len(failed) - len(lines)
    lines += [f"and {more} more; see the column reason of results.csv"] if more else []
    counted = listed(f"{number} x {reason}" for reason, number in reasons)
    each = f"<details open><summary>Which</summary>{listed(lines)}</details>"
    return section("failed", "Failed", f'<div class="warnings">{counted}{each}</div>')


def tags(rows: Sequence[Mapping[str, Any]]) -> tuple[Column, ...]:
    """Returns a column per tag that occurs, the first few."""
    found = dict.fromkeys(key for row in rows for key in row if key.startswith("tag."))
    return tuple(Column(key, key.removeprefix("tag.")) for key in list(found)[:MOST_TAGS])


def table(
    rows: Sequence[Mapping[str, Any]],
    total: int,
    columns: Sequence[Column],
    thumbnails: Mapping[str, bytes],
    links: Mapping[str, str],
) -> Iterator[str]:
    """Yields the table."""
    if len(rows) < total:
        yield paragraph(f"{len(rows)} of {total} photographs are shown here; results.csv holds all of them.")
    yield paragraph("A heading sorts by its column, and again the other way round.", "quiet")
    heads = [
        '<th scope="col">photograph, light</th>',
        heading("name"),
        heading("state"),
        *(heading(column.heading, bool(column.form)) for column in columns),
    ]
    yield '<div class="scroll" tabindex="0" role="region" aria-label="Photographs">'
    yield f'<table id="photographs" class="rows"><thead><tr>{"".join(heads)}</tr></thead><tbody>'
    for row in rows:
        yield line(row, columns, thumbnails.get(row["name"]), links.get(row["name"]))
    yield f'</tbody></table></div><p><button type="button" id="more" data-step="{STEP}" hidden></button></p>'


def heading(name: str, number: bool = False) -> str:
    """Returns the head of a column that sorts the table."""
    kind = ' class="number"' if number else ""
    return f'<th scope="col"{kind}><button type="button">{text(name)}</button></th>'


def line(row: Mapping[str, Any], columns: Sequence[Column], thumbnail: bytes | None, link: str | None) -> str:
    """Returns the line of a photograph."""
    name = text(row["name"])
    image = "" if thumbnail is None else pair(thumbnail, row["name"])
    named = name if link is None else f'<a href="{text(address(link))}">{name}</a>'
    kind = ' class="failed"' if row["state"] == "failed" else ""
    cells = "".join(cell(row.get(column.key), column.form) for column in columns)
    if row["reason"] and columns:  # in place of the figures
        cells = f'<td class="reason" colspan="{len(columns)}" data-value="">{text(row["reason"])}</td>'
    return f'<tr{kind}><td>{image}</td><td class="name">{named}</td><td>{text(row["state"])}</td>{cells}</tr>'


def pair(thumbnail: bytes, name: str) -> str:
    """Returns a row's picture, decoded when it comes into view."""
    source, alternative = data_uri(thumbnail, "jpeg"), text(f"{name}: the photograph, and the upper half of its light")
    return f'<img src="{source}" width="180" height="52" loading="lazy" decoding="async" alt="{alternative}">'


def cell(value: Any, form: str) -> str:
    """Returns a cell; numbers carry themselves for sorting."""
    if not form:
        word = {True: "yes", False: "no", None: ""}.get(value, value) if not isinstance(value, str) else value
        return f"<td>{text(word)}</td>"
    if not isinstance(value, int | float) or not math.isfinite(value):
        return '<td class="number" data-value=""></td>'
    return f'<td class="number" data-value="{value!r}">{value:{form}}</td>'


def address(link: str) -> str:
    """Returns a relative path as an address; every character that means something in one is written as %xx."""
    return quote(os.fsencode(link))
