"""A small sweep: a block on a plane of 8 x 8 samples under a map of a few pixels, solved for a few texels."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import torch

from torchlight.batch.local import Work
from torchlight.batch.work import Report
from torchlight.io.lights import write_light
from torchlight.light.environment import EnvironmentMap
from torchlight.sweep.trial import Trial

DATA = """
data:
  synthetic:
    lights: [sky.exr]
    seen: {rotation_degrees: 20}
    held_out: [{rotation_degrees: 69, translation: [0.3, 0.2]}]
    samples: 8
"""
BASE = "base: {light: {method: texels, resolution: 2}, compute: {no_cache: true, device: cpu}}\n"
GRID = "search: {kind: grid}\n" + BASE + "axes: {light.resolution: [2, 4], data.noise: [0.0, 0.01, 0.02]}\n" + DATA
NOT_COMPARED = ("seconds",)


def write_sweep(folder: Path, text: str = GRID, sky: torch.Tensor | None = None) -> Path:
    """Writes a sweep file with its light beside it and returns its place."""
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator().manual_seed(3)
    radiance = torch.rand(3, 8, 16, generator=generator) if sky is None else sky
    write_light(folder / "sky.exr", EnvironmentMap(radiance), {})
    path = folder / "sweep.yaml"
    path.write_text(text)
    return path


def here(trials: Iterable[Trial], work: Work[Trial]) -> Iterator[Report]:
    """Yields a report per trial, worked on in this process."""
    return map(work, trials)


def fingerprints(out: Path) -> dict[str, dict[str, Any]]:
    """Returns what every trial's folder holds but its seconds."""
    found = {path.parent.name: json.loads(path.read_text()) for path in sorted(out.glob("trials/*/trial.json"))}
    return {name: {k: v for k, v in content.items() if k not in NOT_COMPARED} for name, content in found.items()}
