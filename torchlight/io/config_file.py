"""Configuration files: the tree of `torchlight.config` as YAML, read strictly."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields as fields_of
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from torchlight.config import Config, leaves
from torchlight.errors import ConfigError
from torchlight.io import fields
from torchlight.io.fields import Field
from torchlight.io.yaml_file import read_yaml

Node = TypeVar("Node")


def read_config(path: str | Path) -> Config:
    """Returns the tree that a YAML file describes; what it does not name keeps its default.

    Raises:
        FormatError: missing, or not YAML.
        ConfigError: an unknown key (with a suggestion), or a value of a wrong type.
    """
    document, _ = read_yaml(path)
    return parsed(Config(), Field(document, Path(path), ""))


def with_values(config: Config, values: Mapping[str, object], source: Path) -> Config:
    """Returns the tree with settings given by path, such as {"light.method": "texels"}.

    Raises:
        ConfigError: an unknown path (with a suggestion), or a value of a wrong type; `source` is named.
    """
    known = [path for path, _ in leaves(config)]
    for path, field in fields.mapping(Field(dict(values), source, ""), known).items():
        section, name = path.split(".")
        nested = replace(field, value={name: field.value}, key=section)
        config = replace(config, **{section: parsed(getattr(config, section), nested)})
    return config


def as_yaml(config: Config) -> str:
    """Returns the whole tree as YAML that `read_config` reads."""
    tree: dict[str, dict[str, Any]] = {}
    for path, value in leaves(config):
        section, name = path.split(".")
        tree.setdefault(section, {})[name] = value
    return yaml.safe_dump(tree, sort_keys=False)


def parsed(node: Node, field: Field) -> Node:
    """Returns a node of the tree with what a mapping says, strictly."""
    hints = get_type_hints(type(node))
    known = [one.name for one in fields_of(node)]  # pyright: ignore[reportArgumentType]
    changes = {
        name: parsed(getattr(node, name), value) if is_dataclass(getattr(node, name)) else scalar(value, hints[name])
        for name, value in fields.mapping(field, known).items()
    }
    return replace(node, **changes)  # pyright: ignore[reportArgumentType, reportCallIssue]


def scalar(field: Field, kind: Any) -> Any:
    """Returns a value of one of the kinds that settings have: a choice, true or false, a number, or nothing."""
    if get_origin(kind) in (Union, types.UnionType):
        if field.value is None and type(None) in get_args(kind):
            return None
        return scalar(field, next(part for part in get_args(kind) if part is not type(None)))
    if get_origin(kind) is Literal:
        return fields.choice(field, get_args(kind))
    if kind is bool:
        if not isinstance(field.value, bool):
            field.wrong_type("true or false")
        return field.value
    if kind is int:
        if isinstance(field.value, bool) or not isinstance(field.value, int):
            field.wrong_type("an integer")
        return field.value
    if kind is float:
        return fields.number(field)
    raise ConfigError(field.describe(f"cannot be set from a file ({kind})"))
