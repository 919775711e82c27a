"""The word before a compilation: said once, and not when machine code comes from the disk."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from workbench import torchlight as run

from torchlight import cli
from torchlight.compiled import ANNOUNCEMENT

KERNEL = """
from torchlight.compiled import compiled

@compiled
def once(x):
    return x + 1

@compiled
def twice(x):
    return once(x) + once(x)
"""
LISTENED = "import logging, sys; logging.basicConfig(format='%(name)s %(message)s', level=logging.INFO)\n"
CALLED = "from kernel import twice; assert twice({}) == {}\n"
OTHERS = "from numba import njit; assert njit(lambda x: x + 1)(1) == 2\n"


@pytest.fixture
def python(tmp_path: Path) -> Callable[[str], list[str]]:
    """A function that runs code in a new process, with a kernel and a cache of its own; returns what it complains."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}

    def run_code(code: str) -> list[str]:
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout == ""
        return done.stderr.splitlines()

    return run_code


def test_the_first_compilation_alone_is_announced(python: Callable[[str], list[str]]) -> None:
    said = f"torchlight {ANNOUNCEMENT}"
    assert python(LISTENED + CALLED.format(2, 6) + CALLED.format(2.5, 7.0)) == [said]  # four compilations
    assert python(LISTENED + CALLED.format(2, 6)) == []  # from the disk
    assert python(LISTENED + CALLED.format("1j", "2 + 2j")) == [said]  # of a type that is not there


def test_what_only_a_compiler_must_know_is_loaded_for_a_compilation_only(python: Callable[[str], list[str]]) -> None:
    known = "import sys; assert ('numba.typed.typedlist' in sys.modules) is {}\n"
    python(CALLED.format(2, 6))
    python(CALLED.format(2, 6) + known.format(False) + CALLED.format(2.5, 7.0) + known.format(True))


def test_a_library_is_silent(python: Callable[[str], list[str]]) -> None:
    assert python(CALLED.format(2, 6)) == []


def test_functions_of_others_are_not_announced(python: Callable[[str], list[str]]) -> None:
    assert python("import torchlight.compiled\n" + LISTENED + OTHERS) == []


def test_every_kernel_would_announce_itself() -> None:
    """Numba's decorator is used in one place only."""
    package = Path(cli.__file__).parents[1]
    users = [path.name for path in package.rglob("*.py") if "import njit" in path.read_text()]
    assert users == ["compiled.py"]


def test_the_command_line_prints_it_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    import logging

    def entries() -> list[object]:
        logging.getLogger("torchlight").info("one\n  two")
        return []

    monkeypatch.setattr("torchlight.io.cache.entries", entries)
    assert run("cache", "list").line == "torchlight: one two"
    assert run("cache", "list").line == "torchlight: one two"  # and still once the second time
    logger = logging.getLogger("torchlight")
    assert (logger.handlers, logger.level) == ([], logging.NOTSET)
