"""YAML, strictly: one document of plain mappings, lists, text and numbers.

Refused: tags (which can name Python objects), duplicate keys, many aliases (which can expand without bound), and
YAML 1.1's surprises: only true/false are booleans, 012 is twelve, 1e-3 is a number, 12:30 is text.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from torchlight.errors import ConfigError, FormatError
from torchlight.io.files import one_line, read_bytes

MAX_YAML_BYTES = 1 << 18  # a thousand occluders; more takes the parser many seconds
MAX_ALIASES = 32
MAX_DEPTH = 32


def read_yaml(path: str | Path) -> tuple[object, bytes]:
    """Returns the document and the file's bytes.

    Raises:
        FormatError: missing, not text, empty or not YAML.
        ConfigError: tags, duplicate keys, too many aliases or nested too deep.
    """
    data = read_bytes(path, MAX_YAML_BYTES)
    try:
        # S506: _StrictLoader descends from SafeLoader and refuses every tag
        document = yaml.load(data.decode("utf-8-sig"), Loader=_StrictLoader)  # noqa: S506
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text file; expected a scene written in YAML") from error
    except _RefusedError as error:
        raise ConfigError(f"{path}{_line(error)}: {error.problem}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise FormatError(f"{path}{_line(error)}: not valid YAML: {_problem(error)}") from error
    if document is None:
        raise FormatError(f"{path}: the file holds no scene; see configs/scenes for commented examples")
    return document, data


_TAGGED = (yaml.ScalarEvent, yaml.SequenceStartEvent, yaml.MappingStartEvent)


class _RefusedError(yaml.MarkedYAMLError):
    """Valid YAML that this format does not allow."""

    def __init__(self, problem: str, mark: yaml.Mark | None) -> None:
        super().__init__(problem=problem, problem_mark=mark)


class _StrictLoader(yaml.SafeLoader):
    """SafeLoader without tags, duplicate keys, alias bombs and YAML 1.1's implicit types."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's own protocol)

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._aliases = 0
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()
        kind = type(event)
        if kind is yaml.AliasEvent:
            self._aliases += 1
            if self._aliases > MAX_ALIASES:
                raise _RefusedError(f"more than {MAX_ALIASES} aliases; write the values out", event.start_mark)
        elif kind in _TAGGED and event.tag is not None:
            raise _RefusedError(
                f"the tag {one_line(event.tag, 60)} is not allowed; write plain values", event.start_mark
            )
        if self._depth >= MAX_DEPTH:
            raise _RefusedError(f"nested more than {MAX_DEPTH} deep", event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _RefusedError("a key must be plain text", key.start_mark)
            if key.value in seen:
                raise _RefusedError(f"the key '{one_line(key.value, 60)}' appears twice; keep one", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Leaves << an ordinary key."""


def _resolve(kind: str, pattern: str, first: list[str]) -> None:
    _StrictLoader.add_implicit_resolver(f"tag:yaml.org,2002:{kind}", re.compile(pattern), first)


def _integer(loader: _StrictLoader, node: yaml.ScalarNode) -> int:
    return int(str(loader.construct_scalar(node)))


# YAML 1.2 core schema, section 10.3.2, without octal and hexadecimal
_resolve("null", r"^(?:~|null|Null|NULL)?$", ["~", "n", "N", ""])
_resolve("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF"))
_resolve("int", r"^[-+]?[0-9]+$", list("-+0123456789"))
_resolve(
    "float",
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
    list("-+0123456789."),
)
_StrictLoader.add_constructor("tag:yaml.org,2002:int", _integer)


def _line(error: BaseException) -> str:
    mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
    return "" if mark is None else f", line {mark.line + 1}"


def _problem(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "nested too deeply"  # through aliases, each in a node that the next names
    if isinstance(error, yaml.MarkedYAMLError) and error.problem:
        return one_line(error.problem)
    return one_line(str(error))
