"""The command line: `torchlight <command>`, one file per command."""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import TextIOWrapper
from types import ModuleType

import tyro

from torchlight.cli import arguments
from torchlight.cli.config_option import expanded
from torchlight.cli.spelling import spelled_out
from torchlight.cli.usage import complaint_in_one_line
from torchlight.errors import TorchlightError

# Read when torch starts its threads. Their default is to spin while they wait, which on a machine that does anything
# else costs several times the work itself.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

NOTHING_STARTED = 2
INTERRUPTED = 130
PIPE_CLOSED = 141
DESCRIPTION = "Recovers light from shadows: photographs of a known object on a plane in, an HDR environment map out."


def main(argv: Sequence[str] | None = None) -> None:
    """Runs one command and exits with its code: 0 done, 1 partly failed, 2 nothing could start, 130 interrupted."""
    code = PIPE_CLOSED
    try:
        try:
            code = run(parse(argv))
        except TorchlightError as error:
            fail(str(error))
            code = NOTHING_STARTED
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # the reader has gone (`| head`): nothing more to say, and Python must not try again when it exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def parse(argv: Sequence[str] | None) -> arguments.Command:
    """Returns the command that the arguments name; prints help and exits where they ask for it.

    Raises:
        TorchlightError: one line that says what is wrong with them, or with the file of --config.
    """
    words = spelled_out(expanded(sys.argv[1:] if argv is None else argv))
    with complaint_in_one_line():
        return tyro.cli(
            tyro.conf.FlagCreatePairsOff[arguments.Command],  # pyright: ignore
            args=words,
            prog="torchlight",
            description=DESCRIPTION,
        )


def run(command: arguments.Command) -> int:
    """Returns the exit code of a command; what a user can mend is one line on standard error, never a traceback."""
    show_warnings_in_one_line()
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file's name may hold what the terminal cannot show
    try:
        with messages_on_standard_error():
            return loaded(type(command).__name__.lower()).run(command)
    except BrokenPipeError:
        raise
    except (TorchlightError, OSError) as error:
        fail(str(error))
        return NOTHING_STARTED
    except KeyboardInterrupt:
        fail("interrupted; what was finished is complete, the rest was not written")
        return INTERRUPTED


def loaded(name: str) -> ModuleType:
    """Returns a command's module with all that it needs.

    What importing makes stays to the end: the garbage collector need not look through it, neither meanwhile nor later.
    """
    gc.disable()
    module = import_module(f"torchlight.cli.{name}")
    gc.freeze()
    gc.enable()
    return module


def fail(message: str) -> None:
    """Prints one line on standard error."""
    print(f"torchlight: {' '.join(message.split())}", file=sys.stderr)


class Lines(logging.Handler):
    """Prints each message as one line on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Prints one message."""
        fail(record.getMessage())


@contextmanager
def messages_on_standard_error() -> Iterator[None]:
    """Prints what the package has to say meanwhile; as a library it is silent unless logging is set up."""
    logger, lines = logging.getLogger("torchlight"), Lines()
    level = logger.level
    logger.addHandler(lines)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(lines)


def show_warnings_in_one_line() -> None:
    """Makes torchlight's own warnings one line on standard error, without the source line that raised them."""
    import warnings

    def show(message, category, filename, lineno, file=None, line=None) -> None:
        print(f"torchlight: warning: {' '.join(str(message).split())}", file=sys.stderr)

    warnings.showwarning = show
