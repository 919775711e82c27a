"""How many lights a second one operator relights, with and without the gradient, and how far it is from cast rays.

    python scripts/bench/relight.py --data DIR

Seconds are processor time of one thread, the least of three runs of 64 lights of 64 x 32 pixels; without DIR no errors.
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro
from measuring import OUT, best, clocked, markdown, save
from photographs import scene

from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap
from torchlight.metrics import rms_255
from torchlight.precomputation import precompute
from torchlight.relighting import relight, relight_by

LIGHTS = 64
PROBES = ("kitchen_cross", "campus_probe", "galileo_probe")


def main(data: Path | None = None, samples: int = 64, out: Path = OUT) -> None:
    """Prints the table and saves it.

    Args:
        data: folder of light probes (DIR/probes/*.hdr).
        samples: of the receiver, along a side.
        out: folder for relight.csv.
    """
    torch.set_num_threads(1)
    where, ones = scene(samples), torch.ones(samples**2)
    lights = EnvironmentMap(torch.rand(LIGHTS, 3, 32, 64, generator=torch.Generator().manual_seed(0)))
    asked = EnvironmentMap(lights.radiance.clone().requires_grad_())
    cast = {}
    for name in PROBES if data is not None else ():
        light = read_light(Path(data or "") / "probes" / f"{name}.hdr")
        light = EnvironmentMap(light.radiance.float())
        shown, cost = clocked(lambda light=light: relight(where, light))
        cast[name] = light, shown
        print(f"{name}: rays take {cost.processor:.0f} s of processor time")
    rows: list[dict[str, object]] = []
    for resolution in (8, 16, 32, 64):
        transfer = precompute(where, resolution)
        _, there = best(lambda transfer=transfer: relight_by(transfer, where, lights), 3)
        _, back = best(lambda transfer=transfer: relight_by(transfer, where, asked).sum().backward(), 3)
        rates = {"lights a second": LIGHTS / there.processor, "with the gradient": LIGHTS / back.processor}
        errors = {
            f"RMS of 255, {name}": rms_255(relight_by(transfer, where, light), shown, ones).item()
            for name, (light, shown) in cast.items()
        }
        rows.append({"case": f"{resolution} texels along an edge", "samples": samples**2, **rates, **errors})
    print(markdown(rows))
    save("relight", rows, threads=1, out=out)


if __name__ == "__main__":
    tyro.cli(main)
