"""Pictures drawn by a process of their own are those drawn here, and no picture is lost with it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from torchlight.drawing import elsewhere
from torchlight.drawing.content import ChannelFates, FatesContent, FitContent, LeftOut

EMPTY = np.zeros((3, 4, 3))
FIT = FitContent(
    (EMPTY, EMPTY + 0.5),
    np.full((3, 4), np.nan),
    1.0,
    (LeftOut(np.eye(3, 4, dtype=bool), "#D55E00", "saturated: 3 samples"),),
    ("observed", "predicted"),
    "a title",
    "mm",
    (0.0, 4.0, 0.0, 3.0),
)
BORDER = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]])
CHANNEL = ChannelFates("red", np.zeros((3, 8), dtype=np.float32), BORDER, ("level", "resolved"), ((0, 1), (1, 8)))
FATES = FatesContent((CHANNEL,), ("#0072B2", "#F3EFD8"), (("#0072B2", "resolved"),))


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> Iterator[elsewhere.Other]:
    """A process that draws."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    elsewhere.begin()
    assert elsewhere.begun()
    process = elsewhere._begun[0]
    yield process
    elsewhere.end()
    assert not elsewhere.begun()
    assert process.process.returncode is not None


@pytest.mark.usefixtures("other")
def test_both_processes_draw_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = [elsewhere.draw(FIT), elsewhere.draw(FATES)]
    monkeypatch.setattr(elsewhere, "draw", None)  # this process cannot
    waiting = [elsewhere.drawn(content) for content in (FIT, FATES)]
    assert [wait() for wait in waiting] == expected


def test_a_process_that_has_gone_is_stood_in_for(other: elsewhere.Other) -> None:
    other.process.kill()
    other.process.wait()
    assert elsewhere.drawn(FATES)() == elsewhere.draw(FATES)


def test_the_working_directory_is_not_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "numpy.py").write_text("raise SystemExit")
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    monkeypatch.chdir(tmp_path)
    one = elsewhere.Other()
    try:
        monkeypatch.setattr(elsewhere, "draw", None)
        assert one.picture(FATES).startswith(b"\x89PNG")
    finally:
        one.end()


@pytest.mark.usefixtures("other")
def test_what_cannot_be_drawn_raises_here() -> None:
    waiting = elsewhere.drawn(FatesContent((CHANNEL,), ("no colour",), ()))
    with pytest.raises(ValueError, match="no colour"):
        waiting()


def test_one_processor_draws_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0}, raising=False)
    elsewhere.begin()
    assert not elsewhere.begun()
    assert elsewhere.drawn(FIT)() == elsewhere.draw(FIT)


def test_the_process_ends_with_its_input_and_does_without_torch() -> None:
    code = "from torchlight.drawing import elsewhere as e; e.serve(); import sys; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], stdin=subprocess.DEVNULL, check=True, timeout=60)
