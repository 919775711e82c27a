"""Do two photographs of one light tell more than each of them? Five lights, rendered.

    python scripts/joint_gain.py --data DIR [--out out/joint] [--samples 160] [--probe NAME]

A block is photographed in two poses by Mitsuba, as scripts/rendered/probes.py sets it up: interreflection, a lacquered
block, lens distortion, 8-bit sRGB, and noise of 1 % of each photograph's brightest sample. The second photograph has
0.6 times the exposure of the first, which nobody is told. The light from each photograph alone and from both together
relights two poses that neither shows. There it is held against two judges:

    rendered: the pose by Mitsuba too. Light that sheet and block throw on each other is in the photographs, so the
        light that is found accounts for it, and the judge must show it. The judge's own grain does not count: of two
        renderings with independent grain, mean((p - h1) (p - h2)) has the expectation mean((p - h)^2).
    analytic: the exact shadow alone, so that thrown-back light counts as error.

Settings are those that `torchlight joint` and `torchlight estimate` have by default; nothing is chosen on these lights.
Renderings are kept in OUT/renderings and used again.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from paper.measure import pose_columns, relit_by_squares
from paper.setting import HELD_OUT, PHOTOGRAPHED, RECEIVER, used_samples
from rendered.photograph import installed, stored
from rendered.probes import ALBEDO, EXPOSED, NOISE, PROBES, light, rendering, scene
from torch import Tensor

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.nodes import NodeColumns
from torchlight.io.images import read_photo, write_png
from torchlight.joint import JointEstimate, View, explain_together, side_by_side
from torchlight.light.environment import EnvironmentMap
from torchlight.observing import linearize, observe
from torchlight.photo.observation import Observation, linear_photo
from torchlight.pipeline import Estimate, explain
from torchlight.precomputation import columns_for, precompute
from torchlight.synthetic import block_values, pixel_rays

PAIR, JUDGES = (PHOTOGRAPHED, HELD_OUT[0]), {"held out 2": HELD_OUT[1], "held out 3": HELD_OUT[2]}
EXPOSURES = (1.0, 0.6)
SETTINGS = AdaptiveHaar()
SEED = 0
NAMES = ("first", "second", "both")
HEAD = (
    "RMS of 255 of the brightest sample, by the light of the first photograph, the second, and both\n\n"
    "| light | pose | rendered: first | second | both | better | analytic: first | second | both | better |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)


@dataclass(frozen=True)
class Scores:
    """RMS of 255 of the brightest sample, of a pose relit.

    Attributes:
        first: by the light of the first photograph.
        second: by that of the second.
        both: by that of both.
    """

    first: float
    second: float
    both: float

    @property
    def better(self) -> bool:
        """Whether both together beat each alone."""
        return self.both < min(self.first, self.second)

    def __str__(self) -> str:
        """Returns three columns of the table."""
        return f"{self.first:.2f} | {self.second:.2f} | {self.both:.2f}"


@dataclass(frozen=True)
class Row:
    """One light on one pose.

    Attributes:
        probe: the light.
        pose: that is relit.
        rendered: scores against Mitsuba's picture of it.
        analytic: scores against the exact shadow alone.
    """

    probe: str
    pose: str
    rendered: Scores
    analytic: Scores


@dataclass(frozen=True, eq=False)
class Lights:
    """What is found in two photographs.

    Attributes:
        alone: the light of each.
        joint: the light of both.
        exposures: from radiance to the linear values of each, as they were.
    """

    alone: tuple[Estimate, ...]
    joint: JointEstimate
    exposures: tuple[float, ...]

    def at_first_exposure(self) -> list[tuple[Estimate, float]]:
        """Returns the light of the first, the second and both, each with the factor to the first's exposure."""
        first, second = self.exposures
        return [(self.alone[0], 1.0), (self.alone[1], first / second), (self.joint.estimate, 1.0)]


def main(data: Path | None = None, out: Path = Path("out/joint"), samples: int = 160, probe: str = "") -> None:
    """Prints the table and writes it to OUT/joint.csv.

    Args:
        data: folder that holds probes/*.hdr; default: the environment variable TORCHLIGHT_DATA.
        out: folder for renderings, photographs and table.
        samples: light paths per pixel.
        probe: one light, by the name of its file, instead of the five.
    """
    folder = (data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))) / "probes"
    if not folder.is_dir():
        sys.exit(f"joint_gain: no '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    if not installed():
        sys.exit("joint_gain: needs Mitsuba 3; pip install 'torchlight[mitsuba]'")
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    print(HEAD)
    for name in (probe,) if probe else PROBES:
        environment = light(folder / f"{name}.hdr")
        found = lights(name, environment, samples, out)
        for pose in JUDGES:
            rows.append(judged(name, pose, found, environment, samples, out))
            print(line(rows[-1]), flush=True)
        scale = found.joint.scales.values[1].item()
        deviation = found.joint.scales.deviations[1].item() * scale
        true = found.exposures[1] / found.exposures[0]
        print(f"    {name}: exposure found {scale:.4f} +- {deviation:.4f}, true {true:.4f}", file=sys.stderr)
    write_table(rows, out / "joint.csv")
    for pose in JUDGES:
        here = [row for row in rows if row.pose == pose]
        counts = [sum(getattr(row, judge).better for row in here) for judge in ("rendered", "analytic")]
        print(f"{pose}: both beat each alone on {counts[0]} of {len(here)} rendered, {counts[1]} analytic")


def lights(name: str, environment: EnvironmentMap, samples: int, out: Path) -> Lights:
    """Returns what each photograph alone and both together say."""
    files, exposures = photographs(name, environment, samples, out)
    scenes = [scene(block) for block in PAIR]
    seen = [observed(file, here) for file, here in zip(files, scenes, strict=True)]
    transfers = [precompute(here, SETTINGS.dense_resolution) for here in scenes]
    alone = tuple(explained(one, here) for one, here in zip(seen, scenes, strict=True))
    views = [View(here, one) for here, one in zip(scenes, seen, strict=True)]
    joint = explain_together(views, side_by_side(scenes, transfers, SETTINGS), SETTINGS.basis, SETTINGS)
    return Lights(alone, joint, exposures)


def photographs(
    name: str, environment: EnvironmentMap, samples: int, out: Path
) -> tuple[list[Path], tuple[float, ...]]:
    """Returns the two photographs and their exposures, from radiance to stored linear values."""
    pictures = [rendering(environment, block, samples, out / "renderings").radiance for block in PAIR]
    first = observe(linear_photo(pictures[0]), scene(PAIR[0]))
    unit = EXPOSED / metrics.brightest(first.samples, first.weights).item()
    files = [out / f"{name}_{index + 1}.png" for index in range(len(PAIR))]
    for index, (file, picture, factor) in enumerate(zip(files, pictures, EXPOSURES, strict=True)):
        write_png(file, stored(picture, unit * factor, NOISE * EXPOSED * factor, SEED + index))
    return files, tuple(unit * factor for factor in EXPOSURES)


def observed(file: Path, here: Scene) -> Observation:
    """Returns what a photograph on disk shows."""
    return observe(linearize(read_photo(file), here), here)


def explained(observation: Observation, here: Scene) -> Estimate:
    """Returns the light of one photograph."""
    return explain(observation, here, columns_for(here, SETTINGS.basis, SETTINGS), SETTINGS.basis, SETTINGS)


def judged(name: str, pose: str, found: Lights, environment: EnvironmentMap, samples: int, out: Path) -> Row:
    """Returns the scores of the three lights on a pose, by both judges."""
    block = JUDGES[pose]
    halves = observe(linear_photo(rendering(environment, block, samples, out / "renderings").halves), scene(block))
    rendered = Observation(halves.samples * found.exposures[0], halves.weights)
    used = used_samples(block)
    exact = shadow_alone(environment, block, out / f"{name}_{pose.replace(' ', '_')}.pt") * ALBEDO * found.exposures[0]
    shown = [relit(estimate, block) * factor for estimate, factor in found.at_first_exposure()]
    by_picture = [rms_without_grain(one, rendered) for one in shown]
    by_shadow = [metrics.rms_255(one, exact.to(one), used.to(one)).item() for one in shown]
    return Row(name, pose, Scores(*by_picture), Scores(*by_shadow))


def relit(estimate: Estimate, block: Block) -> Float[Tensor, "3 points"]:
    """Returns what the light predicts for a pose, as a photograph of albedo 1 shows it."""
    if estimate.refinement is None:
        raise ValueError("the adaptive method names its squares")
    columns = kept_columns(block)
    return relit_by_squares(columns, estimate.solution.coefficients, estimate.refinement) / torch.pi


@cache
def kept_columns(block: Block) -> NodeColumns:
    """Returns the columns of a pose, kept for all lights."""
    return pose_columns(block, SETTINGS.max_resolution)


def rms_without_grain(shown: Float[Tensor, "3 points"], halves: Observation) -> float:
    """Returns the RMS of 255 of the brightest sample against two pictures that differ in nothing but their grain.

    sqrt(mean((p - h1) (p - h2))), which the grain does not enlarge on average; 0 where grain makes the mean negative.
    """
    used = (halves.weights > 0).all(dim=0)
    first, second = halves.samples.double()[..., used]
    own = shown.double()[:, used]
    square = ((own - first) * (own - second)).mean().clamp(min=0)
    return (255 * square.sqrt() / ((first + second) / 2).max()).item()


def shadow_alone(environment: EnvironmentMap, block: Block, path: Path) -> Float[Tensor, "3 points"]:
    """Returns v = E / pi of a pose by the exact shadow, kept on disk."""
    if not path.exists():
        torch.save(block_values(block, RECEIVER, pixel_rays(environment)).float(), path)
    return torch.load(path)


def line(row: Row) -> str:
    """Returns a line of the table."""
    judges = " | ".join(f"{scores} | {answer(scores)}" for scores in (row.rendered, row.analytic))
    return f"| {row.probe} | {row.pose} | {judges} |"


def answer(scores: Scores) -> str:
    """Returns whether both together beat each alone, in a word."""
    return "yes" if scores.better else "NO"


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Writes the scores as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["probe", "pose", *(f"{judge}_{name}" for judge in ("rendered", "analytic") for name in NAMES)])
        writer.writerows((row.probe, row.pose, *astuple(row.rendered), *astuple(row.analytic)) for row in rows)


if __name__ == "__main__":
    tyro.cli(main)
