"""What one photograph cannot tell: a light that explains it as well, and other poses better.

    python scripts/paper_identifiable.py --data DIR [--probe kitchen_cross]

The setting is that of reproduce_paper.py: a block photographed in one pose, light judged by four others. Beside the
light found from the photograph alone stands one found, by the same method and settings, from the photograph and the
four other poses together. Where the second explains the photograph no worse than the first, the photograph holds
nothing that would prefer it: what the first gets wrong in the other poses is not a fault of the method but not in the
photograph. Shadows that end beyond the receiver's edge in one pose and on it in another are the usual cause.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
import tyro
from paper.measure import pose_columns, relit_by_squares
from paper.setting import POSES, RECEIVER, exposed
from paper.truth import Truth, truths

from torchlight import metrics
from torchlight.errors import TorchlightError
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.io.lights import read_light
from torchlight.joint import side_by_side
from torchlight.photo.observation import Observation
from torchlight.precomputation import Columns, precompute
from torchlight.synthetic import block_scene, eight_bit

SETTINGS = AdaptiveHaar()


def main(data: Path | None = None, probe: str = "kitchen_cross", out: Path = Path("out/paper")) -> None:
    """Prints the table.

    Args:
        data: folder that holds probes/*.hdr; default: the environment variable TORCHLIGHT_DATA.
        probe: which light, by the name of its file.
        out: folder that keeps the ground truth.
    """
    path = (data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))) / "probes" / f"{probe}.hdr"
    if not path.exists():
        sys.exit(f"paper_identifiable: no '{path}'; pass --data DIR or set TORCHLIGHT_DATA")
    values, _ = truths(read_light(path), probe, Truth.ANALYTIC, out / "truth", 0)
    seen = exposed(values, 0.0)
    judged = (seen.photo, *seen.truth[1:])
    print(f"{probe}: RMS of 255\n\n| light from | functions | on the photograph | other poses, mean | each |")
    print("| --- | --- | --- | --- | --- |")
    for name, count in (("the photograph", 1), ("the photograph and the other poses", len(POSES))):
        found = solve_adaptive(together(count), pictures(judged[:count]), SETTINGS)
        poses = [pose_columns(block, SETTINGS.max_resolution) for block in POSES]
        shown = [relit_by_squares(pose, found.solution.coefficients, found.refinement) / torch.pi for pose in poses]
        errors = [metrics.rms_255(v, case.samples, case.weights).item() for v, case in zip(shown, judged, strict=True)]
        others = ", ".join(f"{error:.2f}" for error in errors[1:])
        functions, mean = int(found.refinement.functions.max()), sum(errors[1:]) / (len(POSES) - 1)
        print(f"| {name} | {functions} | {errors[0]:.3f} | {mean:.3f} | {others} |")


def pictures(cases: Sequence[Observation]) -> Observation:
    """Returns 8-bit pictures of several poses as the irradiance samples of one receiver."""
    samples = torch.cat([eight_bit(case.samples.double()) for case in cases], dim=-1)
    return Observation(samples * torch.pi, torch.cat([case.weights.double() for case in cases], dim=-1))


def together(count: int) -> Columns:
    """Returns the columns of the first poses, their samples one after another, as of one receiver."""
    scenes = [block_scene(block, RECEIVER) for block in POSES[:count]]
    transfers = [precompute(scene, SETTINGS.dense_resolution) for scene in scenes]
    return side_by_side(scenes, transfers, SETTINGS).columns


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"paper_identifiable: {error}")
