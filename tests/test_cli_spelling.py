"""Settings on the command line: what a file switches on is switched off beside it, and values are spelt as in YAML."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from workbench import torchlight as run

from torchlight.cli.spelling import spelled_out
from torchlight.config import DEFAULTS, leaves

EVERYTHING_ON = """
solver: {robust: true}
checks: {refine_pose: silhouette, estimate_height: true, skip_near_test: true}
compute: {no_cache: true}
output: {skip_pictures: true, skip_confidence: true, skip_report: true}
light: {resolution: 8}
adaptive: {noise: 0.01}
"""
SWITCHES = [path for path, value in leaves(DEFAULTS) if isinstance(value, bool)]
OPTIONAL = [path for path, value in leaves(DEFAULTS) if value is None]


def names(path: str) -> tuple[str, str]:
    """The long and the short option of a setting."""
    return "--" + path.replace("_", "-"), "--" + path.split(".")[1].replace("_", "-")


def shown(*options: object) -> dict[str, object]:
    ran = run("config", "show", *options)
    assert (ran.code, ran.err) == (0, "")
    return {
        f"{section}.{key}": value
        for section, settings in yaml.safe_load(ran.out).items()
        for key, value in settings.items()
    }


@pytest.mark.parametrize("which", [0, 1], ids=["long", "short"])
def test_what_a_file_switches_on_is_switched_off_beside_it(tmp_path: Path, which: int) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(EVERYTHING_ON)
    there = shown("--config", file)
    assert all(there[path] is True for path in SWITCHES)
    assert all(there[path] is not None for path in OPTIONAL)
    off = [word for path in SWITCHES for word in (names(path)[which], "false")]
    nothing = [word for path in OPTIONAL for word in (names(path)[which], "null")]
    assert shown("--config", file, *off, *nothing) == dict(leaves(DEFAULTS))
    joined = [f"{names(path)[which]}=False" for path in SWITCHES]
    assert shown(*joined, f"--config={file}") == there | dict.fromkeys(SWITCHES, False)


@pytest.mark.parametrize("which", [0, 1], ids=["long", "short"])
def test_a_bare_switch_is_on(which: int) -> None:
    options = [names(path)[which] for path in SWITCHES]
    expected = dict(leaves(DEFAULTS)) | dict.fromkeys(SWITCHES, True)
    assert shown(*options) == expected
    assert shown(*[word for option in options for word in (option.replace("no-", "no_"), "true")]) == expected


def test_only_settings_are_touched() -> None:
    words = ["estimate", "s.yaml", "--robust", "true.png", "--out", "null", "--refine-pose", "p.png"]
    expected = ["estimate", "s.yaml", "--robust", "True", "true.png", "--out", "null", "--refine-pose", "shadow"]
    assert spelled_out(words) == [*expected, "p.png"]
    assert spelled_out(["batch", "--refine-pose", "silhouette"]) == ["batch", "--refine-pose", "silhouette"]
    for words in ([], ["analyze", "--no-cache", "a.yaml"], ["sweep", "true"], ["--help"]):
        assert spelled_out(words) == words


def test_a_value_that_is_neither_is_one_line() -> None:
    ran = run("config", "show", "--robust=perhaps")
    assert ran.code == 2
    assert "'perhaps'" in ran.line
