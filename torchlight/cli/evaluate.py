"""`torchlight evaluate`: how well a light explains a photograph, as JSON."""

from __future__ import annotations

import json

from torchlight import metrics
from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.io.images import read_photo
from torchlight.io.lights import read_light
from torchlight.io.scene_file import load_scene
from torchlight.observing import check_lit, linearize, observe, placed
from torchlight.relighting import relight
from torchlight.results import number, visibility


def run(command: arguments.Evaluate) -> int:
    """Prints rms_255, rms_relative, visible and points; with --fit-scale also the factor of each channel."""
    scene = load_scene(command.scene)
    photo = read_photo(command.photo)
    scene = placed(scene, photo, str(command.photo))
    observation = observe(linearize(photo, scene), scene)
    check_lit(observation)
    light = read_light(command.light, command.convention)
    with progress_bar("casting rays") as progress:
        predicted = relight(scene, light, command.rays, progress).to(observation.samples)
    samples, weights = observation.samples, observation.weights
    result: dict[str, object] = {}
    if command.fit_scale:
        scale = metrics.fit_scale(predicted, samples, weights)
        predicted = predicted * scale[:, None]
        result["scale"] = [number(factor) for factor in scale]
    result["rms_255"] = number(metrics.rms_255(predicted, samples, weights))
    result["rms_relative"] = number(metrics.rms_relative(predicted, samples, weights))
    print(json.dumps({**result, **visibility(observation)}, indent=2))
    return 0
