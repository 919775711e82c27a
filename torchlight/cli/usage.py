"""What is wrong with the arguments, in one line: tyro says it in a framed text of several."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr

from torchlight.errors import TorchlightError


class UsageError(TorchlightError):
    """The arguments name no command that can run."""


@contextmanager
def complaint_in_one_line() -> Iterator[None]:
    """Raises UsageError instead of the exit of a failed parse, and keeps its framed text from the terminal.

    Help is left alone.
    """
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            yield
    except SystemExit as stop:
        if not stop.code:
            raise
        raise UsageError(condensed(said.getvalue())) from None


def condensed(text: str) -> str:
    """Returns the first paragraph of a framed text, with the option it suggests or the commands there are.

    Paragraphs are parted by rules; under a suggestion stand the option, then its help, indented further. Where the
    terminal knows no frames, the title is a paragraph of its own.
    """
    paragraphs: list[list[str]] = [[]]
    for line in text.splitlines():
        inner = line.strip().removeprefix("│").removesuffix("│")
        if line.strip()[:1] in ("╭", "╰"):
            continue
        if inner.strip() and not inner.strip(" ─-"):
            paragraphs.append([])
        elif inner.strip():
            paragraphs[-1].append(inner)
    paragraphs = [paragraph for paragraph in paragraphs if paragraph]
    if "│" not in text and len(paragraphs) > 1:
        del paragraphs[0]
    if not paragraphs:
        return "these arguments name no command; see torchlight --help"
    said = " ".join(" ".join(line.split()) for line in paragraphs[0])
    options = [
        line.split()[0].rstrip(",")
        for paragraph in paragraphs[1:]
        for line in paragraph
        if line.strip().startswith("--")
    ]
    commands = [p for p in paragraphs[1:] if p[0].strip().startswith("Available")]
    if "Perhaps you meant" in text and options:
        said = said.rstrip(".") + f"; perhaps you meant {options[0]}"
    elif commands:
        said = said.rstrip(".") + "; " + " ".join(" ".join(line.split()) for line in commands[0])
    return f"{said.rstrip('.')}; see torchlight --help"
