"""How long torchlight takes to start, from a shell: help, import, one small photograph; and how much memory.

    python scripts/bench/startup.py [--runs 5] [--out out/bench]

Every run is a process of its own; wall and processor seconds are the least of some runs, memory the most. The
photograph is that of scripts/demo (64 x 64 samples), estimated with the default settings, all pictures written and
the near-light test included: with the scene's transport on disk (warm), and with an empty cache folder (cold).
Compiled kernels and modules are on disk in both, as they are from the second run on a machine (PYTHONDONTWRITEBYTECODE
is unset: with it every process would compile every module again). The yardstick of the same run is the import of torch,
of kornia (which imports torch) and, where it is installed, of Mitsuba. OMP_NUM_THREADS sets the
threads of all.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import tyro
from measuring import OUT, markdown, save

SCENE = Path(__file__).resolve().parents[2] / "configs" / "scenes" / "block.yaml"
ALL = "import torchlight as tl; [getattr(tl, name) for name in tl.__all__]"


@dataclass(frozen=True)
class Run:
    """What one process took: seconds of waiting, processor seconds of all its threads, and its largest memory."""

    wall: float
    processor: float
    peak_gib: float


def main(runs: int = 5, out: Path = OUT) -> None:
    """Prints a Markdown table and writes OUT/startup.csv.

    Args:
        runs: of each command.
        out: where the CSV goes.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    threads = int(os.environ.get("OMP_NUM_THREADS", str(os.cpu_count())))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene, photo = photographed(folder)
        command = [*torchlight(), "estimate", str(scene), str(photo), "--out", str(folder / "results"), "--overwrite"]
        cache = {**os.environ, "TORCHLIGHT_CACHE": str(folder / "cache")}
        timed(command, cache)  # compiles kernels and fills the cache
        torch = least([sys.executable, "-c", "import torch"], runs)
        rows = [
            row("torchlight --help", least([*torchlight(), "--help"], runs), asked=0.5),
            row("import torch", torch),
            row("import torchlight", least([sys.executable, "-c", "import torchlight, torch"], runs), torch, 0.2),
            row("import torchlight and all its names", least([sys.executable, "-c", ALL], runs), beyond=torch),
            *(row(f"import {peer}", least([sys.executable, "-c", f"import {peer}"], runs)) for peer in peers()),
            row("estimate, warm", least(command, runs, cache), asked=3.0),
            row("estimate, cold", least(command, runs, cache, lambda: shutil.rmtree(folder / "cache")), asked=5.0),
        ]
    print(markdown(rows))
    save("startup", rows, threads, out)


def torchlight() -> list[str]:
    """Returns the words that run the command line by this very Python."""
    return [sys.executable, "-c", "from torchlight.cli import program; program()"]


def peers() -> list[str]:
    """Returns the peers that are installed."""
    return [name for name in ("kornia", "mitsuba") if find_spec(name) is not None]


def photographed(folder: Path) -> tuple[Path, Path]:
    """Returns the scene and the photograph of the demo, which is linear."""
    timed([*torchlight(), "demo", "--out", str(folder)], dict(os.environ))
    scene = folder / "block.yaml"
    scene.write_text(SCENE.read_text().replace("encoding: srgb", "encoding: linear"))
    return scene, folder / "photo.png"


def least(
    command: list[str], runs: int, environment: dict[str, str] | None = None, before: Callable[[], object] | None = None
) -> Run:
    """Returns the least seconds and the most memory of some runs, each after what is to be done before it."""
    found = []
    for _ in range(runs):
        if before is not None:
            before()
        found.append(timed(command, dict(os.environ) if environment is None else environment))
    return Run(min(r.wall for r in found), min(r.processor for r in found), max(r.peak_gib for r in found))


def timed(command: list[str], environment: dict[str, str]) -> Run:
    """Runs a process to its end.

    Raises:
        CalledProcessError: it failed.
    """
    start = time.perf_counter()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Run(time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20)


def row(what: str, run: Run, beyond: Run | None = None, asked: float | None = None) -> dict[str, object]:
    """Returns a row of the table; `beyond` is what the same process would take anyway."""
    less = Run(0.0, 0.0, 0.0) if beyond is None else beyond
    return {
        "what": what if beyond is None else f"{what}, beyond torch",
        "seconds": run.wall - less.wall,
        "processor seconds": run.processor - less.processor,
        "peak memory, GiB": run.peak_gib,
        "asked, seconds": asked,
    }


if __name__ == "__main__":
    tyro.cli(main)
