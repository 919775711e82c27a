"""At which tolerance of the rank the paper's B = 5 and B = 4 appear: the recommended bandwidth over many tolerances.

    python scripts/paper_nullity.py

Analyses configs/paper/above.yaml, low.yaml and half.yaml as `torchlight analyze` does, with tolerances from 1e-12 to
1e-3, and prints the table that docs/analysis.md sums up.
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro

from torchlight.analysis.nullity import MATLAB, equations, nullity
from torchlight.analysis.sampling import random_rotations
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.cli.analyze import RESOLUTION
from torchlight.errors import TorchlightError
from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute
from torchlight.report.case import used_samples

SCENES = Path(__file__).resolve().parent.parent / "configs" / "paper"
TOLERANCES = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 2e-7, 3e-7, 5e-7, 1e-6, 1e-5, 1e-4, 1e-3)


def main(bandwidth_max: int = 8, rotations: int = 300, seed: int = 0) -> None:
    """Prints the recommended B of each view at each tolerance."""
    turns = random_rotations(rotations, seed)
    print("| view | " + " | ".join((MATLAB, *(f"{tolerance:.0e}" for tolerance in TOLERANCES))) + " |")
    print("| --- |" + " --- |" * (1 + len(TOLERANCES)))
    for name in ("above", "low", "half"):
        scene = load_scene(SCENES / f"{name}.yaml")
        used = used_samples(scene)
        harmonics = transfer_harmonics(precompute(scene, RESOLUTION), bandwidth_max - 1)
        found = nullity(equations(harmonics, len(used))[used], turns, TOLERANCES)
        recommended = [str(found.recommended(tolerance)) for tolerance in found.tolerances]
        print(f"| {name} | " + " | ".join(recommended) + " |")


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"paper_nullity: {error}")
