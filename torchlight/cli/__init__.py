"""The command line: `torchlight <command>`, one file per command."""

from __future__ import annotations

import atexit
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from io import StringIO, TextIOWrapper
from typing import get_args

import tyro

from torchlight.cli import arguments
from torchlight.cli.config_option import expanded
from torchlight.cli.loading import TYPEGUARD, begin, end, loaded, postponed
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


def program() -> None:
    """Runs `main` as what a process is there for, and ends the process without taking its modules apart.

    That would take a quarter of a second. What is registered for the end is still done.
    """
    codes: list[int] = []

    def leave() -> None:
        end()
        if codes:
            with suppress(OSError):  # nobody reads it any more
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(codes[0])

    atexit.register(leave)  # before all others, so called after them
    try:
        begin(sys.argv[1:])
        main()
    except KeyboardInterrupt:  # while arguments were read
        fail("interrupted; nothing was started")
        codes.append(INTERRUPTED)
    except SystemExit as stop:
        if isinstance(stop.code, int):
            codes.append(stop.code)
        raise


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
    command = parsed_alone(words)
    if command is not None:
        return command
    with complaint_in_one_line():
        return tyro.cli(
            tyro.conf.FlagCreatePairsOff[arguments.Command],  # pyright: ignore
            args=words,
            prog="torchlight",
            description=DESCRIPTION,
        )


def parsed_alone(words: Sequence[str]) -> arguments.Command | None:
    """Returns the command by its own options alone, which takes a fifth of the time that those of all take.

    None where there is something to explain: help, or what is wrong with the arguments.
    """
    kinds = {kind.__name__.lower(): kind for kind, _ in map(get_args, get_args(arguments.Command))}
    if not words or words[0] not in kinds or {"-h", "--help"} & set(words):
        return None
    try:
        with redirect_stderr(StringIO()), postponed("typeguard", TYPEGUARD):
            return tyro.cli(tyro.conf.FlagCreatePairsOff[kinds[words[0]]], args=words[1:])  # pyright: ignore
    except SystemExit:
        return None


def run(command: arguments.Command) -> int:
    """Returns the exit code of a command; what a user can mend is one line on standard error, never a traceback."""
    show_warnings_in_one_line()
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file's name may hold what the terminal cannot show
    try:
        with messages_on_standard_error():
            return loaded(command).run(command)
    except BrokenPipeError:
        raise
    except (TorchlightError, OSError) as error:
        fail(str(error))
        return NOTHING_STARTED
    except KeyboardInterrupt:
        fail("interrupted; what was finished is complete, the rest was not written")
        return INTERRUPTED


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
