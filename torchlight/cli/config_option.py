"""`--config FILE`: the settings of a file, as if they had been given before all other options."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

NAME = "--config"


def expanded(arguments: Sequence[str]) -> list[str]:
    """Returns the arguments with what the file says put first, so that what is given beside it counts.

    Raises:
        TorchlightError: the file cannot be read, or a setting in it is wrong.
    """
    for index, argument in enumerate(arguments):
        if argument == NAME and index + 1 < len(arguments):
            file, rest = arguments[index + 1], [*arguments[1:index], *arguments[index + 2 :]]
        elif argument.startswith(f"{NAME}="):
            file, rest = argument.partition("=")[2], [*arguments[1:index], *arguments[index + 1 :]]
        else:
            continue
        from torchlight.config import as_options
        from torchlight.io.config_file import read_config

        return [arguments[0], *as_options(read_config(Path(file))), *rest]
    return list(arguments)
