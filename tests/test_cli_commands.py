"""The command line as a whole: help, start-up, cache, doctor, demo, and how errors end."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import torch
from workbench import contents, exr, png, scene_file
from workbench import torchlight as run

from torchlight import cli, demo
from torchlight.cli import arguments
from torchlight.cli.doctor import opencv_wheels
from torchlight.cli.progress import progress_bar
from torchlight.errors import SceneError, TorchlightWarning
from torchlight.io.exr import write_exr

COMMANDS = ("estimate", "render", "insert", "relight", "evaluate", "cache", "doctor", "demo")


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))


def help_of(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    with pytest.raises(SystemExit) as stop:
        cli.main([*command, "--help"])
    assert stop.value.code == 0
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of(capsys)
    assert all(command in text for command in COMMANDS)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("estimate", ("SCENE", "PHOTO", "--out DIR", "--method", "--basis", "--resolution", "--degree", "--solver")),
        ("estimate", ("--device", "--overwrite", "--no-cache", "texels", "haar", "sh", "nnls", "ridge", "adam")),
        ("render", ("SCENE", "LIGHT", "--out IMAGE", "--convention", "--exposure", "--rays", "--overwrite")),
        (
            "insert",
            ("PHOTO", "--scene SCENE", "--light LIGHT", "--object MESH", "--out IMAGE", "--layer", "--position X Y"),
        ),
        ("relight", ("SCENE", "LIGHT", "--photo PHOTO", "--from OLD_LIGHT", "--remove-shadow", "--hole", "--gain")),
        ("evaluate", ("SCENE", "PHOTO", "LIGHT", "--fit-scale", "--convention", "--rays")),
        (
            "convert",
            ("LIGHT|axes", "--out FILE", "--from", "--to", "--size", "--rotate", "--primaries", "opengl-strip"),
        ),
        ("cache", ("list", "clear")),
        ("doctor", ("versions",)),
        ("demo", ("--out", "--probe", "--convention")),
    ],
)
def test_help_of_every_command(capsys: pytest.CaptureFixture[str], command: str, words: tuple[str, ...]) -> None:
    text = help_of(capsys, command)
    assert all(word in text for word in words)
    assert "--no-overwrite" not in text


@pytest.mark.parametrize("module", ["torchlight", "torchlight.cli", "torchlight.cli.arguments"])
def test_start_up_imports_nothing_heavy(module: str) -> None:
    code = f"import {module}, sys; print(*({{'torch', 'kornia', 'matplotlib', 'cv2', 'trimesh'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize(
    "wrong", [[], ["paint"], ["cache"], ["estimate", "--method", "svd"], ["render", "--rays", "x"]]
)
def test_wrong_usage_exits_2(capsys: pytest.CaptureFixture[str], wrong: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(wrong)
    assert stop.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


# --- how errors end ------------------------------------------------------------------------------------------------


def raising(error: BaseException) -> Callable[[], object]:
    def entries() -> object:
        raise error

    return entries


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (SceneError("receiver.samples:\n  too\tmany"), 2, "torchlight: receiver.samples: too many"),
        (PermissionError(13, "Permission denied", "/locked"), 2, "torchlight: [Errno 13] Permission denied: '/locked'"),
        (KeyboardInterrupt(), 130, "torchlight: interrupted; what was finished is complete, the rest was not written"),
    ],
)
def test_what_a_user_can_mend_is_one_line(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, says: str
) -> None:
    monkeypatch.setattr("torchlight.io.cache.entries", raising(error))
    ran = run("cache", "list")
    assert (ran.code, ran.line) == (code, says)


def test_a_bug_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchlight.io.cache.entries", raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        cli.run(arguments.Cache("list"))


def test_ctrl_c_while_torch_is_being_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchlight.cli.loading.import_module", lambda name: raising(KeyboardInterrupt())())
    ran = run("cache", "list")
    assert ran.code == 130
    assert "interrupted" in ran.line


def test_warnings_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        cli.show_warnings_in_one_line()
        warnings.warn("not cached:\n  the disk", TorchlightWarning, stacklevel=1)
    assert capsys.readouterr().err == "torchlight: warning: not cached: the disk\n"


def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("torchlight")), "doctor"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == ""
    assert process.returncode in (0, 141)


def test_progress_is_silent_when_not_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("casting rays") as advance:
        advance(1, 2)
        advance(2, 2)
    assert capsys.readouterr() == ("", "")


# --- cache and doctor ----------------------------------------------------------------------------------------------


def test_cache_is_listed_and_cleared(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    assert run("cache", "list").out == f"{folder}: 0 entries, 0.0 of 8192 MiB\n"
    photo, scene = png(tmp_path / "p.png"), scene_file(tmp_path)
    for resolution in (2, 4):
        assert run("estimate", scene, photo, "--out", tmp_path / str(resolution), "--resolution", resolution).code == 0
    *entries, total = run("cache", "list").out.splitlines()
    assert total.startswith(f"{folder}: 2 entries, ")
    stems = sorted(path.stem for path in folder.iterdir())
    assert sorted(line.split()[0] for line in entries) == stems
    ran = run("cache", "clear")
    assert ran.code == 0
    assert ran.out.endswith(" MiB freed\n")
    assert contents(folder) == []
    assert run("cache", "list").out.startswith(f"{folder}: 0 entries")


def test_a_limit_that_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE_LIMIT", "8 GB")
    ran = run("cache", "list")
    assert ran.code == 2
    assert "TORCHLIGHT_CACHE_LIMIT" in ran.line


def test_doctor_says_what_a_bug_report_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchlight.cli.doctor.opencv_wheels", lambda: ["opencv-contrib-python-headless 5.0"])
    ran = run("doctor")
    assert (ran.code, ran.err) == (0, "")
    facts = {line[:32].strip(): line[33:] for line in ran.out.splitlines()}
    assert facts["torch"] == torch.__version__
    assert facts["python"] == sys.version.split()[0]
    assert facts["visibility"].startswith(("embree, ", "torch, "))
    assert facts["cache"] == f"{tmp_path / 'cache'}, 0 entries, limit 8.0 GiB"
    assert facts["OpenCV wheels"] == "opencv-contrib-python-headless 5.0"
    assert "warning" not in ran.out


@pytest.mark.parametrize("wheels", [[], ["opencv-python 4.10", "opencv-contrib-python-headless 5.0"]])
def test_doctor_warns_of_wheels_that_overwrite_each_other(monkeypatch: pytest.MonkeyPatch, wheels: list[str]) -> None:
    monkeypatch.setattr("torchlight.cli.doctor.opencv_wheels", lambda: wheels)
    assert "warning: exactly one OpenCV wheel" in run("doctor").out


def test_opencv_wheels_are_found() -> None:
    assert any(wheel.startswith("opencv-contrib-python") for wheel in opencv_wheels())


# --- demo ----------------------------------------------------------------------------------------------------------


def test_demo_prints_paths_errors_and_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = demo.Outcome(1.234, 0.567, 8.9, (tmp_path / "photo.png", tmp_path / "light.exr"))
    monkeypatch.setattr("torchlight.cli.demo.run_demo", lambda *arguments: outcome)
    ran = run("demo", "--out", tmp_path / "demo")
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.splitlines()[:2] == [str(path) for path in outcome.files]
    assert "RMS 1.23 of 255" in ran.out
    assert "RMS 0.57 of 255" in ran.out
    assert "8.9 s" in ran.out


@pytest.mark.parametrize(
    ("radiance", "says"),
    [
        (torch.zeros(3, 8, 16), "black"),
        (torch.cat([torch.zeros(3, 4, 16), torch.ones(3, 4, 16)], dim=1), "black"),
        (-torch.ones(3, 8, 16), "black"),
        (torch.ones(3, 5, 16), "p.exr"),
    ],
)
def test_probes_that_cannot_be_used(tmp_path: Path, radiance: torch.Tensor, says: str) -> None:
    write_exr(tmp_path / "p.exr", radiance, {})
    ran = run("demo", "--out", tmp_path / "demo", "--probe", tmp_path / "p.exr")
    assert ran.code == 2
    assert says in ran.line


@pytest.mark.parametrize("options", [("--probe", "none.hdr"), ("--out", "file"), ("--out", "file/below")])
def test_demo_refuses_before_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, str]) -> None:
    monkeypatch.chdir(tmp_path)
    exr(tmp_path / "file")
    monkeypatch.setattr("torchlight.demo.columns_for", raising(ZeroDivisionError()))
    ran = run("demo", *options)
    assert ran.code == 2
    assert options[1] in ran.line
    with suppress(FileNotFoundError):
        assert contents(tmp_path / "demo-out") == []
