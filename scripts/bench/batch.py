"""How many photographs `torchlight batch` does in a second, what that costs in memory, and what a second worker brings.

    python scripts/bench/batch.py --count 2000 --ratio-count 200 --scenes 1000 --data DIR
    python scripts/bench/batch.py --count 0 --ratio-count 200 --scenes 0 --data DIR

One scene with many photographs under turned light probes (without DIR, under the built-in sky) with two workers; fewer
of them with one worker (one process of one thread) and with two, for the ratio; then scenes of one photograph each,
whose transports nothing shares. A part of no photographs is left out. Resident memory is that of all processes together
when 10, 50 and 100 % of the photographs have ended; the shares are of the time of all processes, by stage.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from jaxtyping import Float
from measuring import OUT, markdown, save
from photographs import photographs
from torch import Tensor

from torchlight.io.images import write_png
from torchlight.io.scene_file import load_scene

SCENE = """units: unit
occluders: [{{box: [1, 0.6, 1.2], rotation_degrees: [0, 0, {turn}]}}]
receiver: {{size: [4, 4], samples: [64, 64]}}
photo: {{encoding: linear}}
"""
MARKS = (0.1, 0.5, 1.0)
SHARE = re.compile(r"([a-z][a-z ]*) (\d+)%")


@dataclass(frozen=True)
class Run:
    """What one batch took: seconds from the shell, resident GiB at the marks, and what it said last."""

    seconds: float
    resident: tuple[float, ...]
    said: str


def main(
    count: int = 2000,
    ratio_count: int = 200,
    scenes: int = 1000,
    data: Path | None = None,
    options: str = "--skip-pictures --skip-near-test",
    out: Path = OUT,
) -> None:
    """Prints the table and saves it.

    Args:
        count: photographs of the one scene, with two workers.
        ratio_count: of these, those that one worker and two are compared on.
        scenes: of one photograph each.
        data: folder of light probes (DIR/probes/*.hdr).
        options: of `torchlight batch`.
        out: folder for batch.csv.
    """
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as name:
        folder, words = Path(name), options.split()
        if ratio_count > 0:
            few = one_scene(folder / "few", ratio_count, data)
            alone = batch(few, folder / "alone", ratio_count, 1, words)
            both = batch(few, folder / "both", ratio_count, 2, words)
            ratio = {"times one worker": round(alone.seconds / both.seconds, 2)}
            rows += [row("one scene", ratio_count, 1, alone), row("one scene", ratio_count, 2, both) | ratio]
        if count > 0:
            one = one_scene(folder / "one", count, data)
            rows += [row("one scene", count, 2, batch(one, folder / "whole", count, 2, words))]
        if scenes > 0:
            many = many_scenes(folder / "many", scenes)
            rows += [row("a scene each", scenes, 2, batch(many, folder / "each", scenes, 2, words))]
    print(markdown(rows))
    save("batch", rows, threads=1, out=out)


def row(case: str, count: int, workers: int, run: Run) -> dict[str, object]:
    """Returns a line of the table."""
    marks = {f"GiB at {mark:.0%}": round(size, 3) for mark, size in zip(MARKS, run.resident, strict=True)}
    rate = {"photographs a second": round(count / run.seconds, 2), "seconds each": round(run.seconds / count, 3)}
    shares = {f"{stage}, %": int(share) for stage, share in SHARE.findall(run.said)}
    stated = {"case": case, "photographs": count, "workers": workers, "seconds": round(run.seconds, 1)}
    return {**stated, **rate, **marks, **shares}


def one_scene(folder: Path, count: int, data: Path | None) -> Path:
    """Writes a scene and photographs of it under lights of their own; returns the manifest."""
    folder.mkdir()
    (folder / "block.yaml").write_text(SCENE.format(turn=20))
    shown = photographs(load_scene(folder / "block.yaml"), count, data)
    for index in range(count):
        write_photo(folder / f"{index:05d}.png", shown.samples[index])
    return manifest(folder, [f'{{"photo": "{index:05d}.png", "scene": "block.yaml"}}' for index in range(count)])


def many_scenes(folder: Path, count: int) -> Path:
    """Writes scenes of one photograph each, under the built-in sky; returns the manifest."""
    folder.mkdir()
    for index in range(count):
        scene = folder / f"{index:05d}.yaml"
        scene.write_text(SCENE.format(turn=90 * index / count))
        write_photo(folder / f"{index:05d}.png", photographs(load_scene(scene), 1, None, index).samples[0])
    lines = [f'{{"photo": "{index:05d}.png", "scene": "{index:05d}.yaml"}}' for index in range(count)]
    return manifest(folder, lines)


def manifest(folder: Path, lines: list[str]) -> Path:
    """Writes a manifest and returns its place."""
    path = folder / "photographs.jsonl"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_photo(path: Path, samples: Float[Tensor, "3 points"]) -> None:
    """Writes the samples as an 8-bit rectified photograph."""
    shown = samples.reshape(3, 64, 64).flip(1)
    pixels = (shown * (230 / shown.max())).round().byte().permute(1, 2, 0).contiguous()
    write_png(path, pixels.numpy())


def batch(listed: Path, out: Path, count: int, workers: int, options: Sequence[str]) -> Run:
    """Returns what `torchlight batch` took for a manifest."""
    call = ["batch", str(listed), "--out", str(out), "--workers", str(workers), *options]
    command = [sys.executable, "-c", "from torchlight.cli import program; program()", *call]
    journal = out / "journal" / "shard-1-of-1.jsonl"
    resident: list[float] = []
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            ended = journal.read_bytes().count(b"\n") if journal.is_file() else 0
            while len(resident) < len(MARKS) and ended >= MARKS[len(resident)] * count:
                resident.append(resident_gib(process.pid))
            time.sleep(0.05)
        said = process.stdout.read() if process.stdout is not None else ""
    seconds = time.perf_counter() - start
    if process.returncode != 0:
        raise SystemExit(f"torchlight batch ended with {process.returncode}: {said}")
    shutil.rmtree(out)
    return Run(seconds, tuple(resident + [0.0] * (len(MARKS) - len(resident))), said.strip().splitlines()[-1])


def resident_gib(leader: int) -> float:
    """Returns the resident memory of a process and its descendants, in GiB (Linux)."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    family = {leader}
    while grown := {child for child, parent in parents.items() if parent in family} - family:
        family |= grown
    pages = 0
    for member in family:
        try:
            pages += int(Path(f"/proc/{member}/statm").read_text().split()[1])
        except OSError:
            continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**30


if __name__ == "__main__":
    tyro.cli(main)
