"""A small batch on the disk, run by the command line in a process of its own, and what its folder holds."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute

SCENE = """units: mm
occluders: [{box: [20, 20, 60]}]
receiver: {size: [160, 160], samples: [16, 16]}
photo: {encoding: linear}
"""
SAMPLES = 16
METHODS = {
    "texels": ("--method", "texels", "--resolution", "2"),
    "adaptive": ("--method", "adaptive", "--resolution", "16"),
}
PROGRAM = "import sys; from torchlight.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Case:
    """A folder with a scene, its photographs and a cache of its own.

    Attributes:
        folder: of all files.
        method: one of `METHODS`.
    """

    folder: Path
    method: str

    @property
    def scene(self) -> Path:
        """The scene file."""
        return self.folder / "scene.yaml"

    @property
    def photos(self) -> Path:
        """The folder of the photographs."""
        return self.folder / "photos"

    def command(self, out: Path, *more: str, source: str | None = None) -> list[str]:
        """Returns the call that does the batch."""
        source = str(self.photos / "*.png") if source is None else source
        options = ["--scene", str(self.scene), "--out", str(out), "--skip-pictures", "--skip-near-test"]
        return [sys.executable, "-c", PROGRAM, "batch", source, *options, *METHODS[self.method], *more]

    def environment(self, **more: str) -> dict[str, str]:
        """Returns the variables that it is done under: one thread, its own cache."""
        own = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "TORCHLIGHT_CACHE": str(self.folder / "cache")}
        return {**os.environ, **own, **more}

    def run(
        self,
        out: Path,
        *more: str,
        source: str | None = None,
        variables: Mapping[str, str] | None = None,
        before: Callable[[], None] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Does the batch to its end and returns exit code and what it said."""
        return subprocess.run(
            self.command(out, *more, source=source),
            env=self.environment(**(variables or {})),
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=before,
        )


def made(folder: Path, method: str, count: int) -> Case:
    """Writes scene and 16-bit photographs, each under a light of its own, and returns the case."""
    case = Case(folder, method)
    case.photos.mkdir(parents=True)
    case.scene.write_text(SCENE)
    transport = precompute(load_scene(case.scene), 2, 8, use_cache=False).transport.double()
    random = torch.Generator().manual_seed(1)
    for index in range(count):
        light = torch.rand(3, transport.shape[1], generator=random, dtype=torch.float64)
        shown = (light @ transport.T / torch.pi).reshape(3, SAMPLES, SAMPLES).flip(1)
        stored = (0.9 * 65535 * shown / shown.max()).round().numpy().astype(np.uint16)
        cv2.imwrite(str(case.photos / f"p{index:03d}.png"), stored[::-1].transpose(1, 2, 0))
    return case


def fingerprints(out: Path, names: Sequence[str] | None = None) -> dict[str, str]:
    """Returns the digest of every file of photographs' folders but their timing, and of the tables where all is there.

    Args:
        out: of a batch.
        names: of the photographs; None = all there are, with the tables.
    """
    files = [file for file in sorted((out / "photos").rglob("*")) if file.is_file() and file.name != "timing.json"]
    if names is not None:
        files = [file for file in files if file.parent.name in names]
    tables = [] if names is not None else [out / "results.jsonl", out / "results.csv"]
    return {str(file.relative_to(out)): digest(file) for file in [*files, *tables] if file.exists()}


def digest(file: Path) -> str:
    """Returns the SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def journal_lines(out: Path) -> list[dict[str, str]]:
    """Returns the records of a batch's journals; cut-off lines are left out."""
    found = []
    for path in sorted((out / "journal").glob("*.jsonl")):
        for line in path.read_bytes().splitlines():
            try:
                found.append(json.loads(line))
            except ValueError:
                continue
    return found


def reasons(out: Path) -> dict[str, str]:
    """Returns the last reason of every photograph that the journal says failed."""
    last = {line["name"]: line for line in journal_lines(out)}
    return {name: line["reason"] for name, line in last.items() if line["state"] == "failed"}


def leftovers(out: Path) -> list[str]:
    """Returns hidden things in the folder of the photographs, which killed processes left."""
    return sorted(path.name for path in (out / "photos").glob(".*"))
