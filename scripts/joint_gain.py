"""Do two photographs of one light tell more than each of them? Five lights, rendered.

    python scripts/joint_gain.py --data DIR [--out out/joint] [--samples 160] [--probe NAME]

A block is photographed in two poses by Mitsuba, as scripts/rendered/probes.py sets it up: interreflection, a lacquered
block, lens distortion, 8-bit sRGB, and noise of 1 % of each photograph's brightest sample. The second photograph has
0.6 times the exposure of the first, which nobody is told. The scenes state the block's albedo, so that what it throws
back is taken away (`occluder_albedo`). The light from each photograph alone and from both together relights two poses
that neither shows. There it is held against three judges:

    rendered: a photograph of the pose by Mitsuba, without noise, what the block throws back taken away likewise. The
        judge's own grain does not count: of two renderings with independent grain, mean((p - h1) (p - h2)) has the
        expectation mean((p - h)^2).
    exact: the exact shadow of a black block, on the samples that such a photograph shows.
    everywhere: the same on all samples, also those that the block hides from the camera. Their shadows are cast by
        light from the camera's side, of which no photograph shows much.

Settings are those that `torchlight joint` and `torchlight estimate` have by default; nothing is chosen on these lights.
`--gloss matt` and `--gloss none` render a block without lacquer, of the albedo that is stated, or a black one: what is
different then is due to the direction in which lacquer throws light back, which `occluder_albedo` does not know.
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
from typing import Literal

import torch
import tyro
from jaxtyping import Float
from paper.measure import pose_columns, relit_by_squares
from paper.setting import HELD_OUT, PHOTOGRAPHED, RECEIVER, used_samples
from rendered.photograph import installed, stored
from rendered.probes import (
    ALBEDO,
    BLACK,
    EXPOSED,
    LACQUERED,
    MATT,
    NOISE,
    PROBES,
    Finish,
    Rendering,
    light,
    rendering,
    scene,
)
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
FINISHES = {"lacquer": LACQUERED, "matt": MATT, "none": BLACK}
Gloss = Literal["lacquer", "matt", "none"]
JUDGED_BY = ("rendered", "exact", "everywhere")
HEAD = (
    "RMS of 255 of the brightest sample, by the light of the first photograph, the second, and both\n\n"
    "| light | pose | rendered: first | second | both | better | exact: first | second | both | better "
    "| everywhere: first | second | both | better |\n"
    f"| --- | --- {'| --- ' * 12}|"
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
        exact: scores against the exact shadow, on the samples that the picture shows.
        everywhere: the same on all samples.
    """

    probe: str
    pose: str
    rendered: Scores
    exact: Scores
    everywhere: Scores


@dataclass(frozen=True)
class Setting:
    """What all lights share.

    Attributes:
        samples: light paths per pixel.
        out: folder for renderings, photographs and table.
        finish: of the block.
    """

    samples: int
    out: Path
    finish: Finish

    def seen(self, block: Block) -> Scene:
        """Returns what the estimate is told of a pose."""
        return scene(block, self.finish.albedo)

    def rendered(self, environment: EnvironmentMap, block: Block) -> Rendering:
        """Returns Mitsuba's two pictures of a pose."""
        return rendering(environment, block, self.samples, self.out / "renderings", self.finish)


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


def main(
    data: Path | None = None,
    out: Path = Path("out/joint"),
    samples: int = 160,
    probe: str = "",
    gloss: Gloss = "lacquer",
) -> None:
    """Prints the table and writes it to OUT/joint.csv.

    Args:
        data: folder that holds probes/*.hdr; default: the environment variable TORCHLIGHT_DATA.
        out: folder for renderings, photographs and table.
        samples: light paths per pixel.
        probe: one light, by the name of its file, instead of the five.
        gloss: of the block.
    """
    folder = (data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))) / "probes"
    if not folder.is_dir():
        sys.exit(f"joint_gain: no '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    if not installed():
        sys.exit("joint_gain: needs Mitsuba 3; pip install 'torchlight[mitsuba]'")
    out.mkdir(parents=True, exist_ok=True)
    setting, rows = Setting(samples, out, FINISHES[gloss]), []
    print(HEAD)
    for name in (probe,) if probe else PROBES:
        environment = light(folder / f"{name}.hdr")
        found = lights(name, environment, setting)
        for pose in JUDGES:
            rows.append(judged(name, pose, found, environment, setting))
            print(line(rows[-1]), flush=True)
        print(f"    {name}: {told(found)}", file=sys.stderr)
    write_table(rows, out / "joint.csv")
    for pose in JUDGES:
        here = [row for row in rows if row.pose == pose]
        counts = ", ".join(f"{sum(getattr(row, judge).better for row in here)} {judge}" for judge in JUDGED_BY)
        print(f"{pose}: of {len(here)} lights both together beat each alone on {counts}")


def lights(name: str, environment: EnvironmentMap, setting: Setting) -> Lights:
    """Returns what each photograph alone and both together say."""
    files, exposures = photographs(name, environment, setting)
    scenes = [setting.seen(block) for block in PAIR]
    seen = [observed(file, here) for file, here in zip(files, scenes, strict=True)]
    transfers = [precompute(here, SETTINGS.dense_resolution) for here in scenes]
    alone = tuple(explained(one, here) for one, here in zip(seen, scenes, strict=True))
    views = [View(here, one) for here, one in zip(scenes, seen, strict=True)]
    joint = explain_together(views, side_by_side(scenes, transfers, SETTINGS), SETTINGS.basis, SETTINGS)
    return Lights(alone, joint, exposures)


def told(found: Lights) -> str:
    """Returns the exposure and the noise that were found, in a line."""
    scales, true = found.joint.scales, found.exposures[1] / found.exposures[0]
    scale = scales.values[1].item()
    noise = " and ".join(f"{255 * one.noise.item():.2f}" for one in found.alone if one.noise is not None)
    deviation = scales.deviations[1].item() * scale
    return f"exposure found {scale:.4f} +- {deviation:.4f}, true {true:.4f}; noise of a sample {noise} of 255"


def photographs(name: str, environment: EnvironmentMap, setting: Setting) -> tuple[list[Path], tuple[float, ...]]:
    """Writes the two 8-bit photographs and returns them with the factors from radiance to their linear values."""
    pictures = [setting.rendered(environment, block).radiance for block in PAIR]
    first = observe(linear_photo(pictures[0]), scene(PAIR[0]))
    unit = EXPOSED / metrics.brightest(first.samples, first.weights).item()
    files = [setting.out / f"{name}_{index + 1}.png" for index in range(len(PAIR))]
    for index, (file, picture, factor) in enumerate(zip(files, pictures, EXPOSURES, strict=True)):
        write_png(file, stored(picture, unit * factor, NOISE * EXPOSED * factor, SEED + index))
    return files, tuple(unit * factor for factor in EXPOSURES)


def observed(file: Path, here: Scene) -> Observation:
    """Returns what a photograph on disk shows."""
    return observe(linearize(read_photo(file), here), here)


def explained(observation: Observation, here: Scene) -> Estimate:
    """Returns the light of one photograph."""
    return explain(observation, here, columns_for(here, SETTINGS.basis, SETTINGS), SETTINGS.basis, SETTINGS)


def judged(name: str, pose: str, found: Lights, environment: EnvironmentMap, setting: Setting) -> Row:
    """Returns the scores of the three lights on a pose, by all judges."""
    block, exposure = JUDGES[pose], found.exposures[0]
    halves = observe(linear_photo(setting.rendered(environment, block).halves), setting.seen(block))
    rendered = Observation(halves.samples * exposure, halves.weights)
    seen, all_samples = halves.weights[0] > 0, used_samples(block)
    exact = shadow_alone(environment, block, setting.out / f"{name}_{pose.replace(' ', '_')}.pt") * ALBEDO * exposure
    shown = [relit(estimate, block) * factor for estimate, factor in found.at_first_exposure()]
    by_picture = [rms_without_grain(one, rendered) for one in shown]
    by_shadow = [
        [metrics.rms_255(one, exact.to(one), used.to(one)).item() for one in shown]
        for used in (seen & all_samples, all_samples)
    ]
    return Row(name, pose, Scores(*by_picture), Scores(*by_shadow[0]), Scores(*by_shadow[1]))


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
    judges = " | ".join(f"{scores} | {answer(scores)}" for scores in (row.rendered, row.exact, row.everywhere))
    return f"| {row.probe} | {row.pose} | {judges} |"


def answer(scores: Scores) -> str:
    """Returns whether both together beat each alone, in a word."""
    return "yes" if scores.better else "NO"


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Writes the scores as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["probe", "pose", *(f"{judge}_{name}" for judge in JUDGED_BY for name in NAMES)])
        for row in rows:
            writer.writerow((row.probe, row.pose, *(v for judge in JUDGED_BY for v in astuple(getattr(row, judge)))))


if __name__ == "__main__":
    tyro.cli(main)
