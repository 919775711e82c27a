"""What a command's process leaves out while it starts, and that nobody misses it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from torchlight.cli import loading
from torchlight.drawing import elsewhere

STARTED = """
import sys
from torchlight.cli import parse
from torchlight.cli.loading import loaded
loaded(parse(["estimate", "scene.yaml", "photo.png", "--out", "x"]))
assert "torch._meta_registrations" not in sys.modules and "matplotlib" not in sys.modules
import torch
assert not hasattr(torch, "_meta_registrations")
import torch._meta_registrations
assert callable(torch._meta_registrations.register_meta)  # who asks for it gets it
"""


def test_an_estimate_starts_without_what_it_does_not_ask_for() -> None:
    subprocess.run([sys.executable, "-c", STARTED], check=True, timeout=120)


def test_a_postponed_module_is_empty_and_then_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "wave", raising=False)
    with loading.postponed("wave"):
        import wave

        assert not hasattr(wave, "open")
    assert "wave" not in sys.modules
    import wave

    assert callable(wave.open)
    with loading.postponed("wave"):  # it is there already
        assert sys.modules["wave"] is wave


def test_a_package_does_not_keep_the_empty_module(monkeypatch: pytest.MonkeyPatch) -> None:
    import xml.dom as package

    monkeypatch.delitem(sys.modules, "xml.dom.pulldom", raising=False)
    monkeypatch.delattr(package, "pulldom", raising=False)
    with loading.postponed("xml.dom.pulldom"):
        setattr(package, "pulldom", sys.modules["xml.dom.pulldom"])  # noqa: B010  (as importing it does)
    assert not hasattr(package, "pulldom")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("estimate scene photo --out x", True),
        ("estimate scene photo --out x --skip-pictures", False),
        ("estimate --help", False),
        ("batch scene --out x", False),
        ("doctor", False),
        ("", False),
    ],
)
def test_only_who_will_draw_begins_to(monkeypatch: pytest.MonkeyPatch, words: str, expected: bool) -> None:
    begun = []
    monkeypatch.setattr(elsewhere, "begin", lambda: begun.append(True))
    monkeypatch.setattr(loading, "load_library_of_torch", lambda: None)
    loading.begin(words.split())
    assert bool(begun) is expected


def test_the_stand_in_is_a_module_for_the_moment_only() -> None:
    known = sys.modules.pop("typeguard", None)
    try:
        with loading.postponed("typeguard", loading.TYPEGUARD):
            import typeguard

            assert typeguard.check_type(1, str) == 1
        import typeguard

        assert isinstance(typeguard, ModuleType)
        with pytest.raises(typeguard.TypeCheckError):
            typeguard.check_type(1, str)
    finally:
        if known is not None:
            sys.modules["typeguard"] = known


def test_ctrl_c_at_the_very_start_is_one_line() -> None:
    code = "from torchlight import cli\ndef begin(words): raise KeyboardInterrupt\ncli.begin = begin; cli.program()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "torchlight: interrupted; nothing was started\n")


def test_a_command_that_cannot_start_leaves_no_process(tmp_path: Path) -> None:
    """Its pipe to standard output closes with it: nothing else holds it open."""
    code = "from torchlight.cli import program; program()"
    command = [sys.executable, "-c", code, "estimate", "no.yaml", "no.png", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("torchlight: no.yaml")
