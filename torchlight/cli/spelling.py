"""Settings on the command line as a file may write them: `--robust`, `--robust false`, `--resolution null`."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from torchlight.config import DEFAULTS, leaves

WITH_SETTINGS = ("estimate", "batch", "joint", "config")
VALUES = {"true": "True", "false": "False", "null": "None", "none": "None"}


@dataclass(frozen=True)
class Spelling:
    """How the values of a setting may be written.

    Attributes:
        bare: what the option means without a value; none = it wants one.
        values: in small letters, those that are put as the parser wants them.
    """

    bare: tuple[str, ...]
    values: frozenset[str]


SWITCH = Spelling(("True",), frozenset({"true", "false"}))
OPTIONAL = Spelling((), frozenset({"null", "none"}))
REFINE_POSE = Spelling(("shadow",), frozenset({"shadow", "silhouette", "null", "none"}))


def spelled_out(argv: Sequence[str]) -> list[str]:
    """Returns the arguments with the value that a bare switch stands for, and values as the parser spells them.

    A switch of the tree of settings is on where it has no value, and a bare `--refine-pose` means shadow.
    """
    if not argv or argv[0] not in WITH_SETTINGS:
        return list(argv)
    table, words, result = dict(spellings()), deque(argv), list[str]()
    while words:
        word = words.popleft()
        name, equals, value = word.partition("=")
        known = table.get(name.replace("_", "-"))
        if known is None:
            result.append(word)
        elif equals:
            result.append(f"{name}={spelt(value)}")
        elif words and words[0].lower() in known.values:
            result += [word, spelt(words.popleft())]
        else:
            result += [word, *known.bare]
    return result


def spelt(value: str) -> str:
    """Returns a value as the parser wants it."""
    return VALUES.get(value.lower(), value)


def spellings() -> Iterator[tuple[str, Spelling]]:
    """Yields the options of the tree whose values may be written in several ways, by their long and short names."""
    for path, value in leaves(DEFAULTS):
        if path == "checks.refine_pose":
            known = REFINE_POSE
        elif isinstance(value, bool):
            known = SWITCH
        elif value is None:
            known = OPTIONAL
        else:
            continue
        yield "--" + path.replace("_", "-"), known
        yield "--" + path.partition(".")[2].replace("_", "-"), known
