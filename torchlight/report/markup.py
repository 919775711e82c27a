"""Pieces of a page that needs nothing but itself: text is escaped, pictures are data, its script is known by a hash."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

DOCUMENT = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'sha256-{style_hash}'; script-src 'sha256-{script_hash}'">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
{body}
<script>{script}</script>
</body>
</html>
"""


def document(title: str, body: Iterable[str], script: str, style: str = "") -> bytes:
    """Returns a page. A browser loads nothing for it and runs no other script than its own.

    Args:
        title: of the page.
        body: pieces of markup.
        script: the name of one of this package's.
        style: more rules, after those of report.css.
    """
    style, code = packaged("report.css") + style, packaged(script)
    page = DOCUMENT.format(
        title=text(title),
        body="\n".join(body),
        style=style,
        script=code,
        style_hash=digest(style),
        script_hash=digest(code),
    )
    return page.encode(errors="backslashreplace")


def packaged(name: str) -> str:
    """Returns a file of this package."""
    return files("torchlight.report").joinpath(name).read_text(encoding="utf-8")


def digest(content: str) -> str:
    """Returns the hash by which a Content-Security-Policy names an inline script or style."""
    return base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()


def text(value: object) -> str:
    """Returns a value as text that holds no markup."""
    return escape(str(value), quote=True)


def data_uri(content: bytes, kind: str = "png") -> str:
    """Returns a picture as an address that holds it."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def picture(content: bytes, alternative: str, size: tuple[int, int], kind: str = "png") -> str:
    """Returns a picture with its text; size is width and height in pixels."""
    width, height = size
    source = data_uri(content, kind)
    return f'<img src="{source}" width="{width}" height="{height}" alt="{text(alternative)}">'


def figure(inside: str, caption: str, below: str = "") -> str:
    """Returns a figure with its caption, which is text."""
    return f"<figure>{inside}{below}<figcaption>{text(caption)}</figcaption></figure>"


def section(identity: str, heading: str, *inside: str) -> str:
    """Returns a part of the page with its heading."""
    return f'<section aria-labelledby="{identity}"><h2 id="{identity}">{text(heading)}</h2>{"".join(inside)}</section>'


def paragraph(content: str, kind: str = "") -> str:
    """Returns a paragraph of text."""
    return f"<p{_kind(kind)}>{text(content)}</p>"


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Returns a table of names and values, both text."""
    inside = "".join(f'<tr><th scope="row">{text(name)}</th><td>{text(value)}</td></tr>' for name, value in rows)
    return f'<table class="facts"><tbody>{inside}</tbody></table>'


def grid(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Returns a table of numbers that may be scrolled sideways."""
    names = "".join(f'<th scope="col" class="number">{text(name)}</th>' for name in head)
    inside = "".join(
        "<tr>" + "".join(f'<td class="number">{text(value)}</td>' for value in row) + "</tr>" for row in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{text(caption)}"><table>'
        f"<caption>{text(caption)}</caption><thead><tr>{names}</tr></thead><tbody>{inside}</tbody></table></div>"
    )


def listed(lines: Iterable[str]) -> str:
    """Returns a list of lines of text."""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"


def _kind(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
