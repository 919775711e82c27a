"""`torchlight config show`: every setting with its value, as YAML that --config reads."""

from __future__ import annotations

from torchlight.cli import arguments
from torchlight.io.config_file import as_yaml


def run(command: arguments.Config) -> int:
    """Prints the tree that the options and the file make together."""
    print(as_yaml(command.settings), end="")
    return 0
