"""`torchlight demo`: the main job on data of its own, in under a minute."""

from __future__ import annotations

import time

from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.demo import run_demo
from torchlight.io.lights import read_light
from torchlight.light.procedural import sun_and_window


def run(command: arguments.Demo) -> int:
    """Prints where the pictures are, the errors and the time."""
    start = time.perf_counter()
    light = sun_and_window() if command.probe is None else read_light(command.probe, command.convention)
    with progress_bar("casting rays") as progress:
        outcome = run_demo(command.out, light, progress)
    for path in outcome.files:
        print(path)
    print(f"fit         RMS {outcome.fit_rms_255:.2f} of 255 (the photograph the light was recovered from)")
    print(f"second pose RMS {outcome.relit_rms_255:.2f} of 255 (never shown to the solver; analytic ground truth)")
    print(f"time        {outcome.seconds:.1f} s to recover the light, {time.perf_counter() - start:.1f} s in all")
    return 0
