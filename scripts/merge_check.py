"""Debevec's Memorial Church merged by `torchlight merge`, against his radiance map.

    python scripts/merge_check.py --data DIR [--out out/merge_check]

DIR holds brackets/memorial: 16 photographs, image_list.txt with their exposures, and memorial.hdr, the reference
(TORCHLIGHT_DATA is used when --data is absent). The response is estimated from the photographs alone. Printed is the
error in ln radiance after one factor per channel, over the pixels where both pictures hold a value: first at the
smoothness that `merge` uses, then at others, which shows how little hangs on it.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from torch import Tensor

from torchlight.cli import arguments, merge
from torchlight.errors import TorchlightError
from torchlight.io.images import Photo, read_photo
from torchlight.photo.brackets import exposed
from torchlight.photo.brackets import merge as merged_brackets
from torchlight.photo.response import CODES, SMOOTHNESS, estimate_response

OTHERS = (3.0, 10.0, 100.0, 300.0)


def main(data: Path | None = None, out: Path = Path("out/merge_check")) -> None:
    """Merges the brackets and prints the errors.

    Args:
        data: folder that holds brackets/memorial; default: the environment variable TORCHLIGHT_DATA.
        out: folder that receives the merged picture; an existing one is replaced.
    """
    folder = (data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))) / "brackets" / "memorial"
    if not (folder / "image_list.txt").exists():
        sys.exit(f"merge_check: no image_list.txt in '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    names, times = exposure_list(folder / "image_list.txt")
    files = tuple(folder / name for name in names)
    out.mkdir(parents=True, exist_ok=True)
    stated = ",".join(f"{time!r}" for time in times)
    command = arguments.Merge(files, out / "memorial.exr", response="estimate", times=stated, overwrite=True)
    merge.run(command)
    reference = read_photo(folder / "memorial.hdr").pixels
    print("| lambda | red | green | blue | 95 % of all below |\n| --- | --- | --- | --- | --- |")
    print(row(f"{SMOOTHNESS:g} (`merge`)", read_photo(command.out).pixels, reference))
    photos = [read_photo(file) for file in files]
    for smoothness in OTHERS:
        print(row(f"{smoothness:g}", merged_at(photos, times, smoothness), reference))


def exposure_list(path: Path) -> tuple[list[str], list[float]]:
    """Returns file names and exposure times; all photographs are at f/8 and no gain."""
    lines = [line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    return [line[0] for line in lines], [float(line[1]) for line in lines]


def merged_at(photos: list[Photo], times: list[float], smoothness: float) -> Float[Tensor, "3 height width"]:
    """Returns the merged radiance with another smoothness of the response."""
    sample = torch.stack([merge.spread(photo.pixels) for photo in photos])
    codes = (sample * (CODES - 1)).round().int().flatten(start_dim=2)
    response = estimate_response(codes, torch.tensor(times, dtype=torch.float64), smoothness)
    looks = (exposed(photo.pixels, response) for photo in photos)
    return merged_brackets(zip(looks, times, strict=True)).radiance


def log_errors(
    found: Float[Tensor, "3 height width"], reference: Float[Tensor, "3 height width"]
) -> list[Float[Tensor, " pixels"]]:
    """Returns |ln found - ln reference| per channel after one factor each, where both are positive."""
    errors = []
    for channel, truth in zip(found.double(), reference.double(), strict=True):
        both = (channel > 0) & (truth > 0)
        difference = channel[both].log() - truth[both].log()
        errors.append((difference - difference.median()).abs())
    return errors


def row(name: str, found: Float[Tensor, "3 height width"], reference: Float[Tensor, "3 height width"]) -> str:
    """Returns a line of the table: the median per channel and the 95 % quantile of all."""
    errors = log_errors(found, reference)
    medians = " | ".join(f"{error.median().item():.4f}" for error in errors)
    most = sorted(torch.cat(errors).tolist())
    return f"| {name} | {medians} | {most[int(0.95 * len(most))]:.3f} |"


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"merge_check: {error}")
