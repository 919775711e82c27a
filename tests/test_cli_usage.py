"""A wrong argument is answered by one line on standard error and exit code 2, and starts nothing."""

from __future__ import annotations

import pytest
from workbench import torchlight as run

from torchlight.cli.usage import condensed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("estimate", "s.yaml", "p.png", "--out", "x", "--resolutoin", "3"), "perhaps you meant --resolution"),
        (("estimate", "s.yaml", "p.png", "--out", "x", "--method", "foo"), "'foo'"),
        (("estimate", "s.yaml", "p.png", "--out", "x", "--methods", "sh"), "perhaps you meant --method; see"),
        (("estimate", "s.yaml", "p.png", "--out", "x", "--functions", "abc"), "--functions"),
        (("estimate", "s.yaml", "p.png"), "--out DIR"),
        (("estimte", "s.yaml"), "Available subcommands: estimate, batch, sweep, analyze"),
        ((), "estimate"),
    ],
)
def test_a_wrong_argument_is_one_line(arguments: tuple[str, ...], message: str) -> None:
    ran = run(*arguments)
    assert ran.code == 2
    assert message in ran.line
    assert ran.line.startswith("torchlight: ")
    assert ran.line.endswith("see torchlight --help")
    assert ran.out == ""


def test_help_is_help() -> None:
    ran = run("estimate", "--help")
    assert (ran.code, ran.err) == (0, "")
    assert "--resolution" in ran.out


def test_only_the_first_paragraph_and_the_first_suggestion_are_kept() -> None:
    text = """\
╭─ Unrecognized options ─╮
│ Unrecognized options:  │
│ --b                    │
│ ────────────────────── │
│ Perhaps you meant:     │
│     --a INT            │
│         Help of a.     │
│     --c INT            │
╰────────────────────────╯
"""
    expected = "Unrecognized options: --b; perhaps you meant --a; see torchlight --help"
    assert condensed(text) == expected
    plain = text.translate({ord(corner): " " for corner in "╮╭╰╯│"}).replace(
        "─ Unrecognized options ─", "Title\n ─────"
    )
    assert condensed(plain.replace("─", "-")) == expected
    assert condensed("") == "these arguments name no command; see torchlight --help"
