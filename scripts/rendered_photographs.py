"""Rendered photographs with all that real ones have, and the error of the light found in them on another pose.

    python scripts/rendered_photographs.py --data DIR [--out out/rendered] [--samples 160] [--probes NAME ...]

Mitsuba renders a lacquered ebony-like block on a white sheet under five measured lights, with all interreflection;
a camera with a barrel lens photographs it from 45 degrees, to 8-bit sRGB with 1 % noise. The files go the way of every
photograph: PNG, scene, samples, light. The block's albedo is stated, and what it throws back is taken away first. The
light is judged on poses never shown, by the exact shadow of the block.
Renderings are kept in the folder `--out`; they are five times as fast where DRJIT_LIBLLVM_PATH names an LLVM.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import tyro
from paper.setting import PHOTOGRAPHED
from rendered.measure import WAYS, Bench, exposed_truth, measured, shown, table
from rendered.photograph import installed
from rendered.probes import PROBES, light, rendering, take

from torchlight.errors import TorchlightError
from torchlight.io.atomic import write_atomically
from torchlight.metrics import rms_255


def main(data: Path, out: Path = Path("out/rendered"), samples: int = 160, probes: tuple[str, ...] = PROBES) -> None:
    """Prints and writes the table.

    Args:
        data: folder that holds probes/*.hdr.
        out: folder for renderings, photographs and the table.
        samples: light paths of Mitsuba per pixel.
        probes: names of the lights.
    """
    if not installed():
        sys.exit("rendered_photographs: needs Mitsuba 3; pip install 'torchlight[mitsuba]'")
    bench, rows = Bench(), []
    for name in probes:
        environment = light(data / "probes" / f"{name}.hdr")
        taken = take(rendering(environment, PHOTOGRAPHED, samples, out), PHOTOGRAPHED, out / f"{name}.png")
        seen = shown(taken)
        thrown = rms_255(seen.photo.samples - seen.thrown, seen.photo.samples, seen.photo.weights).item()
        print(
            f"{name}: the renderer's own grain {100 * taken.own_noise:.1f} % per pixel beside the 1 % added; "
            f"found: noise of a sample {255 * seen.noise:.2f} of 255, light thrown back {thrown:.2f} of 255"
        )
        truth = exposed_truth(environment, taken.exposure)
        for way in WAYS:
            rows.append(measured(name, way, seen, truth, bench))
            print(table(rows[-1:]).splitlines()[-1], flush=True)
        write_atomically(out / "table.json", json.dumps([asdict(row) for row in rows], indent=2).encode())
        write_atomically(out / "table.md", table(rows).encode())
    print(table(rows))


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"rendered_photographs: {error}")
