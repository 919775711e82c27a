"""A trial on photographs of one's own: how well the light that is found explains them."""

from __future__ import annotations

import time

from torchlight.batch.ending import solved, unusable_channels
from torchlight.batch.looking import look
from torchlight.batch.scenes import prepare
from torchlight.config import Config
from torchlight.errors import SolveError
from torchlight.io.images import read_photo
from torchlight.io.sweep_data import Photographs
from torchlight.sweep.synthetic import Measured, solution_figures, together


def measure_photographs(config: Config, data: Photographs) -> Measured:
    """Returns what a configuration makes of photographs.

    Raises:
        TorchlightError: the settings contradict each other or the scene, or a photograph cannot be used.
    """
    scene = data.scene.path
    files = {str(photo.path): photo.path for photo in data.photos if photo.path is not None}
    if scene is None:
        raise SolveError("photographs need a scene file")
    begun = time.perf_counter()
    shared = prepare(scene, config, list(files.values()), use_cache=not config.compute.no_cache)
    cast = time.perf_counter()
    looked = [look(shared.setting, file, read_photo(file)) for file in files.values()]
    each = {}
    start = time.perf_counter()
    for _, one, estimate, _ in solved(shared, looked):
        why = unusable_channels(estimate)
        if why:
            raise SolveError(f"{one.photo}: {why}")
        each[str(one.photo)] = {"fit_rms_255": estimate.rms_255.item(), **solution_figures(estimate)}
    seconds = {"transport": cast - begun, "solve": time.perf_counter() - start}
    found = together(each, ("fit_rms_255", "functions"))
    worst = max(row["fit_rms_255"] for row in each.values())
    ordered = {"fit_rms_255": found["fit_rms_255"], "worst_fit_rms_255": worst}
    return Measured({**ordered, **found}, each, seconds)
