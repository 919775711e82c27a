"""What `torchlight analyze` writes: one folder, complete or absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchlight.analysis.nullity import CONSIDERABLY_LESS_THAN_1, TOLERANCE, Nullity
from torchlight.analysis.observability import DETERMINED, PRIOR
from torchlight.analysis.spectrum import clamped_cosine
from torchlight.analysis.verdict import BLIND, blind
from torchlight.geometry.scene import Scene
from torchlight.io.atomic import partial_folder, write_atomically
from torchlight.io.exr import write_exr
from torchlight.io.files import read_bytes, sha256_of
from torchlight.light.procedural import sun_and_window
from torchlight.preview import to_srgb8
from torchlight.report import charts, hemisphere
from torchlight.report.case import Case
from torchlight.results import CONVENTION, number, versions, write_json
from torchlight.view import refined, render

PICTURE_RAYS = 256
PICTURE_LEVEL = 0.85  # of the brightest pixel
SHOWN_BANDWIDTHS = (3, 6)  # of Fig. 2


@dataclass(frozen=True)
class Settings:
    """What an analysis was asked for.

    Attributes:
        noise: standard deviation per sample, relative to the brightest sample.
        bandwidth_max: largest bandwidth.
        rotations: of the sampling set.
        seed: of the rotations.
    """

    noise: float = 0.01
    bandwidth_max: int = 12
    rotations: int = 300
    seed: int = 0


def write_analysis(folder: Path, cases: Sequence[Case], settings: Settings, overwrite: bool = False) -> dict[str, Any]:
    """Writes the folder of an analysis and returns what analysis.json holds.

    analysis.json, nullity.png, spectrum.png, directions.png, singular_values.png, observability.png and .exr; the
    EXR is that of the last case.

    Raises:
        FormatError: the folder exists and `overwrite` is False, or it cannot be written.
    """
    result = summary(cases, settings)
    pictures = {case.name: scene_picture(case.views[0].scene) for case in cases if len(case.views) == 1}
    drawn = {
        "nullity.png": charts.nullity_picture(cases, pictures),
        "spectrum.png": charts.spectrum_picture(cases),
        "directions.png": charts.directions_picture(SHOWN_BANDWIDTHS),
        "singular_values.png": charts.singular_values_picture(cases, settings.noise),
        "observability.png": hemisphere.observability_picture(cases),
    }
    with partial_folder(folder, overwrite=overwrite) as partial:
        for name, data in drawn.items():
            write_atomically(partial / name, data)
        write_exr(partial / "observability.exr", hemisphere.latlong_map(cases[-1].seen), exr_metadata(cases[-1]))
        write_json(partial / "analysis.json", result)
    return result


def exr_metadata(case: Case) -> dict[str, str]:
    """Returns what the channels of observability.exr mean."""
    return {
        "R": "resolution R_ii",
        "G": "posterior deviation / mean radiance",
        "B": "1 where no used sample is reached",
        "scene": case.name,
        "layout": CONVENTION,
    }


def summary(cases: Sequence[Case], settings: Settings) -> dict[str, Any]:
    """Returns the figures of an analysis, ready for JSON."""
    return {
        "verdict": cases[-1].lines,
        **asdict(settings),
        "rule": f"largest B with mean nullity < {CONSIDERABLY_LESS_THAN_1:g} for it and all smaller ones",
        "tolerance": TOLERANCE,
        "prior_deviation": PRIOR,
        "determined_from": DETERMINED,
        "blind_below": BLIND,
        "cases": [case_summary(case) for case in cases],
        "versions": versions(),
    }


def case_summary(case: Case) -> dict[str, Any]:
    """Returns the figures of one case, ready for JSON."""
    seen, energy = case.seen, case.spectrum.energy
    return {
        "name": case.name,
        "scenes": [str(item.path) for item in case.views],
        "scene_sha256": [sha256_of(read_bytes(item.path)) for item in case.views],
        "samples": sum(len(item.used) for item in case.views),
        "used": sum(int(item.used.sum()) for item in case.views),
        "verdict": case.lines,
        "recommended_bandwidth": recommended(case.curve),
        "nullity": curves(case.curve),
        "recommended_bandwidth_all_samples": recommended(case.ideal),
        "nullity_all_samples": curves(case.ideal),
        "unknowns": case.curve.unknowns.double().mean(dim=-1).tolist(),
        "energy_per_degree": energy.mean(dim=0).tolist(),
        "energy_per_degree_without_shadows": clamped_cosine(energy.shape[1] - 1).square().tolist(),
        "energy_up_to_l_2": number(energy[:, :3].sum() / case.spectrum.total.sum()),
        "degrees_of_freedom": seen.degrees_of_freedom,
        "determined": seen.share(seen.determined),
        "blind": seen.share(blind(seen)),
        "unreached": seen.share(~seen.reached),
        "singular_values": seen.singular_values.tolist(),
    }


def recommended(curve: Nullity) -> dict[str, int]:
    """Returns the recommended bandwidth at each tolerance."""
    return {tolerance_name(tolerance): curve.recommended(tolerance) for tolerance in curve.tolerances}


def curves(curve: Nullity) -> dict[str, Mapping[str, list[float]]]:
    """Returns mean and deviation of the nullity for B = 1, 2, ... at each tolerance."""
    return {
        tolerance_name(tolerance): {"mean": curve.mean[k].tolist(), "deviation": curve.deviation[k].tolist()}
        for k, tolerance in enumerate(curve.tolerances)
    }


def tolerance_name(tolerance: str | float) -> str:
    """Returns a tolerance as text: "MATLAB", "1e-06", ..."""
    return tolerance if isinstance(tolerance, str) else f"{tolerance:.0e}"


def scene_picture(scene: Scene) -> np.ndarray:
    """Returns the scene under the demo's sky as an 8-bit picture: the camera's view, or the receiver from above."""
    shown = scene if scene.camera is not None else replace(scene, receiver=refined(scene.receiver))
    view = render(shown, sun_and_window(dtype=torch.float32), PICTURE_RAYS)
    brightest = torch.quantile(view.values[:, view.shows_plane][:, ::16], 0.98).clamp(min=1e-12)
    values = torch.where(view.opaque, view.values, brightest)
    return to_srgb8(values * (PICTURE_LEVEL / brightest))
