"""The results as one table and as one page of pictures that needs no other file."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass

STYLE = """
body { font: 16px/1.45 sans-serif; color: #222; max-width: 1240px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; } td, th { border-bottom: 1px solid #bbb; padding: 0.3em 0.9em; text-align: left; }
figure { margin: 2.2em 0; } img { width: 100%; height: auto; } figcaption { margin-top: 0.4em; max-width: 60em; }
""".strip()


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: photographs and quantity.
        asked: what is published or asked for.
        measured: what came out.
        met: whether that is as asked; None where nothing is asked.
    """

    what: str
    asked: str
    measured: str
    met: bool | None

    @property
    def verdict(self) -> str:
        """Returns the verdict in a word."""
        return {True: "yes", False: "NO", None: "-"}[self.met]


@dataclass(frozen=True)
class Picture:
    """A PNG and what there is to see on it."""

    name: str
    caption: str
    png: bytes


HEADER = ("photographs", "published or asked", "measured", "met")


def table(rows: Sequence[Row]) -> str:
    """Returns the rows as a Markdown table."""
    lines = ["| " + " | ".join(HEADER) + " |", "| " + " | ".join("---" for _ in HEADER) + " |"]
    return "\n".join(lines + ["| " + " | ".join(cells(row)) + " |" for row in rows])


def page(rows: Sequence[Row], pictures: Sequence[Picture]) -> str:
    """Returns a page of HTML with the table and all pictures in it."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in HEADER)
    body = "\n".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells(row)) + "</tr>" for row in rows)
    figures = "\n".join(figure(picture) for picture in pictures)
    return (
        f'<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8"><title>Real photographs</title>\n'
        f"<style>{STYLE}</style></head>\n<body>\n<h1>Real photographs</h1>\n"
        f"<table>\n<tr>{head}</tr>\n{body}\n</table>\n{figures}\n</body>\n</html>\n"
    )


def figure(picture: Picture) -> str:
    """Returns one picture with its caption, the PNG in the page itself."""
    source = "data:image/png;base64," + base64.b64encode(picture.png).decode()
    name, caption = html.escape(picture.name), html.escape(picture.caption)
    return (
        f'<figure><img alt="{name}" src="{source}"><figcaption><strong>{name}.</strong> {caption}</figcaption></figure>'
    )


def cells(row: Row) -> tuple[str, str, str, str]:
    """Returns what the columns say."""
    return row.what, row.asked, row.measured, row.verdict
