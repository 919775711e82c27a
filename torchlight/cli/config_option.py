"""`--config FILE`: the settings of a file, as if they had been given before all other options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from torchlight.config import DEFAULTS, Config, Method, as_options, leaves
from torchlight.errors import ConfigError

NAME = "--config"
PARTS = {"joint": tuple(field.name for field in fields(Method))}  # commands that do not take the whole tree


def expanded(arguments: Sequence[str]) -> list[str]:
    """Returns the arguments with what the file says put first, so that what is given beside it counts.

    Raises:
        TorchlightError: the file cannot be read, or a setting in it is wrong or none of the command's.
    """
    for index, argument in enumerate(arguments):
        if argument == NAME and index + 1 < len(arguments):
            file, rest = arguments[index + 1], [*arguments[1:index], *arguments[index + 2 :]]
        elif argument.startswith(f"{NAME}="):
            file, rest = argument.partition("=")[2], [*arguments[1:index], *arguments[index + 1 :]]
        else:
            continue
        from torchlight.io.config_file import read_config

        config = read_config(Path(file))
        check_taken(config, arguments[0], file)
        return [arguments[0], *as_options(config), *rest]
    return list(arguments)


def check_taken(config: Config, command: str, file: str) -> None:
    """Raises ConfigError where a file sets what the command does not take."""
    sections, usual = PARTS.get(command), dict(leaves(DEFAULTS))
    for path, value in leaves(config) if sections is not None else ():
        if value != usual[path] and path.partition(".")[0] not in (sections or ()):
            raise ConfigError(f"{file}: {path}: torchlight {command} has no such setting; leave it away")
