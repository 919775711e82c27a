"""Runs the programs that receive exported light, each in its own process."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from exported.browser import answer
from torchlight.io.exr import write_exr

HERE = Path(__file__).parent
SECONDS = 900.0


class AbsentError(Exception):
    """A program is not installed here."""


def run_script(python: str, script: str, job: Mapping[str, Any], folder: Path) -> str:
    """Returns what a script printed last.

    Raises:
        RuntimeError: the script failed.
    """
    path = folder / f"{Path(script).stem}.json"
    path.write_text(json.dumps(job))
    done = subprocess.run(
        [python, str(HERE / script), str(path)], capture_output=True, text=True, timeout=SECONDS, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{script}: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout.strip().splitlines()[-1]


def require(python: str, module: str) -> None:
    """Raises AbsentError unless a Python has a module."""
    looked = [python, "-c", f"import importlib.util as u, sys; sys.exit(u.find_spec({module!r}) is None)"]
    if shutil.which(python) is None or subprocess.run(looked, capture_output=True, check=False).returncode != 0:
        raise AbsentError(f"{python} has no {module}; pip install it there, or name another Python")


def render(program: str, python: str, job: Mapping[str, Any], folder: Path) -> str:
    """Returns the version of Blender or Mitsuba after it has written the pictures of a job."""
    require(python, {"blender": "bpy", "mitsuba": "mitsuba"}[program])
    return run_script(python, f"{program}_block.py", job, folder).removeprefix("version ")


def render_in_browser(browser: str, three: Path, job: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what the page of three.js measured, after its pictures have been written.

    Raises:
        AbsentError: no such browser, or no three.js.
        RuntimeError: the page failed.
    """
    if shutil.which(browser) is None:
        raise AbsentError(f"no browser {browser}; install Chromium, or name another")
    if not (three / "build" / "three.module.js").is_file():
        raise AbsentError(f"no three.js in {three}; npm install three, and name node_modules/three")
    folders = {"page": HERE, "export": Path(job["folder"]), "three": three}
    found = answer(browser, "page/threejs_block.html", folders, job, SECONDS)
    if "error" in found:
        raise RuntimeError(f"three.js: {found['error']}")
    for shot in found["shots"]:
        write_exr(shot["out"], square(shot["pixels"], job["pixels"]), {})
    return found


def square(values: list[float], pixels: int) -> torch.Tensor:
    """Returns a flat picture, red, green, blue, lowest row first, as [3, rows, columns], row 0 at the top."""
    return torch.tensor(values).reshape(pixels, pixels, 3).permute(2, 0, 1).flip(1)


def lookup(program: str, python: str, job: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Returns what usd-core or skylibs says of an export."""
    require(python, {"usd": "pxr", "skylibs": "envmap"}[program])
    return json.loads(run_script(python, f"{program}_lookup.py", job, folder))
