"""What README.md and docs/*.md tell a reader to type works: their Python runs, their commands and flags exist."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from shutil import copytree
from types import ModuleType

import pytest

from torchlight.cli import main
from torchlight.light.cubature import cubature

ROOT = Path(__file__).parent.parent
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL = {"console", "bash", "sh", "shell"}
RAYS = 4096
LANGUAGES = {*SHELL, "python", "yaml", "json", "text", "bibtex", "toml"}
OTHER_PROGRAMS = {"git", "cd", "pip", "export", "pytest"}  # commands that are not ours to check
FLAG = re.compile(r"(?<![\w-])--?[A-Za-z][\w-]*")
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>[^\n`]*)\n(?P<body>.*?)^(?P=indent)```", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block: its document, the line on which its text begins, its language and its text."""

    document: Path
    line: int
    language: str
    text: str


def blocks(document: Path) -> list[Block]:
    text = document.read_text()
    found = []
    for match in FENCE.finditer(text):
        body = "\n".join(line.removeprefix(match["indent"]) for line in match["body"].splitlines())
        line = text.count("\n", 0, match.start("body")) + 1
        found.append(Block(document, line, match["language"].strip(), body))
    return found


def shell_lines(text: str, prompts: bool) -> Iterator[str]:
    """Yields commands, continuation lines joined, comments removed; only those behind `$ ` where there are prompts."""
    for line in text.replace("\\\n", " ").splitlines():
        command = re.sub(r"(^|\s)#.*", "", line).strip()
        if command.startswith("$ ") or (command and not prompts):
            yield command.removeprefix("$ ").strip()


def commands(document: Path) -> list[str]:
    """Returns the commands of a document: in shell blocks, indented blocks and inline code."""
    found = []
    for block in blocks(document):
        if block.language in SHELL:
            prompts = block.language == "console" or block.text.lstrip().startswith("$ ")
            found += shell_lines(block.text, prompts)
    prose = FENCE.sub("", document.read_text())
    found += shell_lines("\n".join(re.findall(r"^(?: {4}|\t)(.*)$", prose, re.MULTILINE)), prompts=True)
    code = (re.sub(r"\s+", " ", span).removeprefix("$ ") for span in re.findall(r"`([^`]+)`", prose))
    return found + [span for span in code if span.split()[:1] and program(span) in {"torchlight", "scripts"}]


def program(command: str) -> str:
    """Returns what a command runs: "torchlight", "scripts" for a script of the repository, else its first word."""
    words = [word for word in command.split() if not re.fullmatch(r"[A-Z_]+=\S*", word)]
    if words and Path(words[0]).name.startswith("python") and len(words) > 1:
        words = words[1:]
    first = words[0].removeprefix("./") if words else ""
    return "scripts" if re.match(r"scripts/\w", first) else Path(first).name


@cache
def help_text(*subcommands: str) -> str:
    """Returns what `torchlight SUBCOMMANDS --help` prints."""
    return printed("torchlight", lambda: main([*subcommands, "--help"]))


@cache
def help_of_script(script: str) -> str:
    """Returns what `python SCRIPT --help` prints.

    It runs in this process, because a new one takes seconds to import torch, but as if alone there: its own folder
    comes first on the path, that of no other script is on it, and no module of a script is known yet.
    """
    path = ROOT / script
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(path), "--help"])
        patch.setattr(sys, "path", [str(path.parent), *(folder for folder in sys.path if not is_ours(folder))])
        for name, module in list(sys.modules.items()):
            if is_ours(getattr(module, "__file__", None)):
                patch.delitem(sys.modules, name)
        return printed(f"python {script}", lambda: runpy.run_path(str(path), run_name="__main__"))


def is_ours(path: str | None) -> bool:
    """Whether a path lies in the folder of the scripts, or in that of the tests."""
    return path is not None and any(Path(path).is_relative_to(ROOT / folder) for folder in ("scripts", "tests"))


def printed(name: str, ask: Callable[[], object]) -> str:
    """Returns what a call for help prints before it exits.

    Raises:
        LookupError: it does not exit with 0.
    """
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        for variable, value in (("COLUMNS", "200"), ("NO_COLOR", "1"), ("TERM", "dumb")):
            patch.setenv(variable, value)
        code: object = 0
        try:
            ask()
        except SystemExit as stop:
            code = stop.code
    if code not in (0, None):
        raise LookupError(f"{name} --help exits {code}: {err.getvalue().strip()}")
    return out.getvalue()


def choices(text: str) -> list[str]:
    """Returns the subcommands that a help text offers: {one,two} in its usage line, outside of [options]."""
    usage = re.sub(r"\[[^\[\]]*\]", "", text.partition("\n\n")[0])
    match = re.search(r"\{([\w,-]+)\}", usage)
    return match[1].split(",") if match else []


def resolve(words: list[str]) -> tuple[str, ...]:
    """Returns the subcommands of torchlight that words name, down to the last.

    Raises:
        LookupError: a subcommand does not exist.
    """
    command: tuple[str, ...] = ()
    for word in words:
        offered = choices(help_text(*command))
        if not offered or not re.match("[a-z]", word):  # an argument, an option, or a placeholder such as COMMAND
            break
        names = word.split("|")
        if not set(names) <= set(offered):
            raise LookupError(f"no subcommand {word}, only {', '.join(offered)}")
        command = (*command, names[0])
    return command


def script_help(script: str) -> str | None:
    """Returns the help of a script of the repository, None where it hands its arguments to pytest."""
    if not (ROOT / script).is_file():
        raise LookupError(f"{script} does not exist")
    if script == "scripts/test":
        return None
    if script == "scripts/demo":
        return help_text("demo")
    return help_of_script(script)


def problem(command: str) -> str | None:
    """Returns what is wrong with a command that a document shows, None if nothing is."""
    runs = program(command)
    if runs in OTHER_PROGRAMS:
        return None
    words = command.split()
    try:
        if runs == "torchlight":
            start = next(i for i, word in enumerate(words) if Path(word).name == "torchlight")
            text = help_text(*resolve(words[start + 1 :]))
        elif runs == "scripts":
            text = script_help(next(word.removeprefix("./") for word in words if "scripts/" in word))
        else:
            return f"{command}: {runs} is not known here; if it is right, add it to OTHER_PROGRAMS"
    except LookupError as error:
        return f"{command}: {error}"
    known = None if text is None else set(FLAG.findall(text))
    unknown = [] if known is None else [flag for flag in FLAG.findall(command) if flag not in known]
    return f"{command}: no such option: {', '.join(unknown)}" if unknown else None


@pytest.fixture(scope="module")
def transports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One cache for all documents, which speak of the same scene."""
    return tmp_path_factory.mktemp("cache")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_python_runs(document: Path, tmp_path: Path, transports: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of one document run in order, in one namespace, in a folder that has the repository's configs.

    Where they cast rays, few do: to cast all would take each document half a minute, and shows no more that it runs.
    """
    copytree(ROOT / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("torchlight.relighting.cubature", lambda light, count: cubature(light, count=min(count, RAYS)))
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(transports))
    module = ModuleType("document_under_test")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for block in blocks(document):
        if block.language == "python":
            source = "\n" * (block.line - 1) + block.text  # so that a traceback names the document's own line
            exec(compile(source, str(document), "exec"), module.__dict__)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_exist(document: Path) -> None:
    problems = [text for command in commands(document) if (text := problem(command))]
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_block_says_what_it_is(document: Path) -> None:
    """A block in a language that is not known would be neither run nor checked."""
    unknown = [
        f"line {block.line}: {block.language!r}" for block in blocks(document) if block.language not in LANGUAGES
    ]
    assert not unknown, "\n".join(unknown)
    assert document.read_text().count("```") == 2 * len(blocks(document))


def test_the_readme_shows_python_and_the_two_scripts() -> None:
    readme = ROOT / "README.md"
    assert any(block.language == "python" for block in blocks(readme))
    shown = {command.split()[0].removeprefix("./") for command in commands(readme)}
    assert {"scripts/demo", "scripts/test", "torchlight"} <= shown


@pytest.mark.parametrize(
    "command",
    [
        "torchlight estimate SCENE PHOTO... --out DIR [--method texels|haar|sh]",
        "torchlight --help",
        ".venv/bin/torchlight doctor",
        "torchlight cache list|clear",
        "torchlight COMMAND --help",
        "scripts/demo --probe FILE.hdr",
        "scripts/test -k haar -x",
        "git clone x",
    ],
)
def test_right_commands_pass(command: str) -> None:
    assert problem(command) is None


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("torchlight guess SCENE", "no subcommand guess"),
        ("torchlight cache lost", "no subcommand lost"),
        ("torchlight estimate SCENE --outt DIR", "no such option: --outt"),
        ("torchlight cache list --everything", "no such option: --everything"),
        ("scripts/demo --sun", "no such option: --sun"),
        ("scripts/nothing", "scripts/nothing does not exist"),
        ("frobnicate x", "frobnicate is not known here"),
    ],
)
def test_wrong_commands_are_reported(command: str, reason: str) -> None:
    message = problem(command)
    assert message is not None
    assert reason in message


def test_commands_are_found_in_every_form(tmp_path: Path) -> None:
    document = tmp_path / "a.md"
    document.write_text(
        "Use `torchlight one --x` or `scripts/demo`, not `torchlight.two`.\n\n"
        "```console\n$ torchlight three \\\n    --y  # why\noutput\n```\n\n"
        "```sh\ntorchlight four\n```\n\n"
        "    $ torchlight five\n\n- item\n  ```python\n  x = 1\n  ```\n"
    )
    expected = ["torchlight three --y", "torchlight four", "torchlight five", "torchlight one --x", "scripts/demo"]
    assert [re.sub(r"\s+", " ", command) for command in commands(document)] == expected
    assert [(block.line, block.text) for block in blocks(document) if block.language == "python"] == [(17, "x = 1")]
