"""How long the nullity takes once the transport is there: 300 rotations, B = 1..12, 4,096 samples.

python scripts/bench/nullity.py [--out out/bench]
"""

from __future__ import annotations

from pathlib import Path

import tyro
from measuring import OUT, Row, clocked, markdown, save

from torchlight.analysis.nullity import equations, nullity
from torchlight.analysis.sampling import random_rotations
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute
from torchlight.threads import thread_count

SCENE = Path(__file__).resolve().parents[2] / "configs" / "paper" / "above.yaml"
RESOLUTION = 32
ASKED = 5.0  # seconds, together


def main(bandwidth_max: int = 12, rotations: int = 300, out: Path = OUT) -> None:
    """Prints the seconds of the projection and of the nullity, for all samples of the view from above.

    Args:
        bandwidth_max: largest bandwidth.
        rotations: of the sampling directions.
        out: where nullity.csv goes.
    """
    scene = load_scene(SCENE)
    transfer = precompute(scene, RESOLUTION)
    harmonics, projected = clocked(lambda: transfer_harmonics(transfer, bandwidth_max - 1))
    turns, asked = random_rotations(rotations, seed=0), equations(harmonics, scene.receiver.points)
    _, counted = clocked(lambda: nullity(asked, turns))
    costs = {"projection": projected, "nullity": counted}
    rows: list[Row] = [
        {"what": name, "samples": len(harmonics), "seconds": cost.wall, "processor seconds": cost.processor}
        for name, cost in costs.items()
    ]
    rows.append({"what": "together", "seconds": projected.wall + counted.wall, "asked, seconds": ASKED})
    print(markdown(rows))
    save("nullity", rows, thread_count(), out)


if __name__ == "__main__":
    tyro.cli(main)
