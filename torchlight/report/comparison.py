"""A light compared with its reference: what is found, as JSON and as a table for the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from torchlight import metrics
from torchlight.geometry.scene import Scene
from torchlight.light_metrics.determined import Determined, Split, determined_directions, split
from torchlight.light_metrics.protocol import MATERIALS, Protocol, SphereTest
from torchlight.light_metrics.summary import Measures, Pair
from torchlight.relighting import lit_by, relight
from torchlight.report.case import used_samples
from torchlight.results import CONVENTION, number, versions
from torchlight.transfer import Transfer

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class SceneComparison:
    """What the difference of two lights means for the photographs of a scene.

    Attributes:
        split: the difference in what a photograph determines and what not.
        basis: the directions of light that it determines.
        noise: of a sample, at which they are.
        samples: that a photograph shows.
        relit_rms_255: of the receiver under the light against that under the reference.
    """

    split: Split
    basis: Determined
    noise: float
    samples: int
    relit_rms_255: float | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything `torchlight compare` found.

    Attributes:
        names: of the light and of the reference.
        heights: rows of their files.
        pair: both on one grid.
        fit: how the light was scaled.
        log_offset: of the logarithms.
        measures: of the two maps.
        protocol: of the spheres.
        spheres: under both.
        scene: what the difference means in photographs; None = not asked.
        flip: mean HDR-FLIP by picture; None = not asked.
    """

    names: tuple[str, str]
    heights: tuple[int, int]
    pair: Pair
    fit: str
    log_offset: float
    measures: Measures
    protocol: Protocol
    spheres: SphereTest
    scene: SceneComparison | None = None
    flip: dict[str, float] | None = None


def against_scene(
    pair: Pair, scene: Scene, transfer: Transfer, noise: float, rays: int, progress: Progress | None = None
) -> SceneComparison:
    """Returns what the difference of two lights means for photographs of a scene.

    Args:
        pair: the lights.
        scene: with its light where theirs stands.
        transfer: of the scene.
        noise: of a sample, as a share of the brightest.
        rays: that each light is cut into for relighting.
        progress: of the relighting: called with (done, all).

    Raises:
        SceneError: the scene shows no sample, or its light stands elsewhere.
        ConfigError: the noise or the rays are out of range.
    """
    used = used_samples(scene)
    basis = determined_directions(transfer, used, noise)
    parts = split(pair.light.radiance, pair.reference.radiance, basis)
    relit, wanted = (relight(lit_by(scene, each), each, rays, progress) for each in (pair.light, pair.reference))
    rms = metrics.rms_255(relit, wanted, used.to(relit))
    return SceneComparison(parts, basis, noise, int(used.sum()), number(rms))


def summary(found: Comparison) -> dict[str, Any]:
    """Returns what compare.json holds; NaN and infinity as null."""
    return {
        "light": found.names[0],
        "reference": found.names[1],
        "rows": list(found.heights),
        "grid_rows": found.pair.light.height,
        "over": found.pair.part,
        "fit": found.fit,
        "scale": numbers(found.pair.scale),
        "units": {"light": found.pair.light.units, "reference": found.pair.reference.units},
        "radiance": radiance_part(found),
        "direction": direction_part(found.measures),
        "totals": totals_part(found.measures),
        "scene": None if found.scene is None else scene_part(found.scene),
        "spheres": spheres_part(found),
        "flip": found.flip,
        "convention": CONVENTION,
        "versions": versions(),
    }


def radiance_part(found: Comparison) -> dict[str, Any]:
    """Returns the errors of radiance."""
    m = found.measures
    return {
        "rmse": number(m.rmse),
        "relative_rmse": number(m.relative_rmse),
        "si_rmse": number(m.scale_invariant.rmse),
        "si_scale": number(m.scale_invariant.scale),
        "channel_si_rmse": number(m.channel_scale_invariant.rmse),
        "channel_si_scale": numbers(m.channel_scale_invariant.scale),
        "log_rmse_stops": number(m.log_rmse),
        "log_offset": found.log_offset,
        "colour_degrees": number(m.colour_angle),
    }


def direction_part(m: Measures) -> dict[str, Any]:
    """Returns the errors of directions, in degrees."""
    pairs = zip(numbers(m.peaks.degrees), numbers(m.peaks.shares), strict=True)
    return {
        "mean_degrees": number(m.mean_direction),
        "strongest_peak_degrees": number(m.peaks.strongest),
        "matched_peaks_degrees": number(m.peaks.mean),
        "peaks": [{"degrees": degrees, "share": share} for degrees, share in pairs if share],
        "missed_peaks": int(m.peaks.missed),
        "extra_peaks": int(m.peaks.extra),
    }


def totals_part(m: Measures) -> dict[str, Any]:
    """Returns the relative errors of totals."""
    return {
        "irradiance": numbers(m.irradiance),
        "irradiance_luminance": number(m.irradiance_luminance),
        "irradiance_colour_degrees": number(m.irradiance_colour),
        "power": numbers(m.power),
        "power_luminance": number(m.power_luminance),
    }


def scene_part(scene: SceneComparison) -> dict[str, Any]:
    """Returns the split of the error, as RMS radiance over the upper hemisphere."""
    parts = scene.split
    return {
        "relit_rms_255": scene.relit_rms_255,
        "rms": number(parts.total),
        "determined_rms": number(parts.determined),
        "null_rms": number(parts.null),
        "finer_rms": number(parts.finer),
        "resolution": scene.basis.resolution,
        "noise": scene.noise,
        "samples": scene.samples,
        "determined_directions": scene.basis.rank,
        "directions": scene.split.null_pattern.shape[-1],
    }


def spheres_part(found: Comparison) -> dict[str, Any]:
    """Returns the protocol and the scores of each material."""
    scores = found.spheres.scores
    fields = ("rmse", "si_rmse", "scale", "norm_rmse", "angle")
    table = {name: {key: number(getattr(scores[name], key)) for key in fields} for name in MATERIALS}
    return {"protocol": asdict(found.protocol), **table}


def numbers(values: Tensor) -> list[float | None]:
    """Returns a vector as floats, None for NaN or infinity."""
    return [number(value) for value in torch.atleast_1d(values)]


# --- the table ------------------------------------------------------------------------------------------------------


def table(result: dict[str, Any]) -> list[str]:
    """Returns what the terminal shows of `summary`."""
    return [*_head(result), "", *map(_row, _map_rows(result)), *_scene_lines(result["scene"]), *_sphere_lines(result)]


def _head(result: dict[str, Any]) -> list[str]:
    rows, units = result["rows"], result["units"]
    where = "above the horizon" if result["over"] == "upper" else "over the sphere"
    scale = "as it is" if result["fit"] == "none" else f"x {_list(result['scale'], '.4g')}"
    return [
        f"light      {result['light']} ({rows[0]} rows, {units['light']}), {scale}",
        f"reference  {result['reference']} ({rows[1]} rows, {units['reference']})",
        f"compared   {where}, on {result['grid_rows']} x {2 * result['grid_rows']} pixels",
    ]


def _map_rows(result: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yields name, value and unit or remark."""
    r, d, t = result["radiance"], result["direction"], result["totals"]
    yield "RMSE", _number(r["rmse"]), f"of radiance; {_number(r['relative_rmse'])} x the reference's RMS"
    yield "si-RMSE", _number(r["si_rmse"]), f"light x {_number(r['si_scale'])}"
    yield "si-RMSE, channels", _number(r["channel_si_rmse"]), f"light x {_list(r['channel_si_scale'], '.4g')}"
    yield "log RMSE", _number(r["log_rmse_stops"]), f"stops; offset {r['log_offset']:g} of the mean radiance"
    yield "colour", _number(r["colour_degrees"]), "degrees, mean angle between RGB vectors"
    yield "mean direction", _number(d["mean_degrees"]), "degrees"
    yield "strongest source", _number(d["strongest_peak_degrees"]), "degrees"
    others = f"{d['missed_peaks']} missed, {d['extra_peaks']} extra"
    yield "matched sources", _number(d["matched_peaks_degrees"]), f"degrees, by share of the flux; {others}"
    yield "irradiance", _percent(t["irradiance_luminance"]), f"R, G, B: {', '.join(map(_percent, t['irradiance']))}"
    yield "its colour", _number(t["irradiance_colour_degrees"]), "degrees"
    yield "power", _percent(t["power_luminance"]), f"R, G, B: {', '.join(map(_percent, t['power']))}"
    for name, mean in (result["flip"] or {}).items():
        yield f"HDR-FLIP, {name}", _number(mean), "0 to 1"


def _scene_lines(scene: dict[str, Any] | None) -> Iterator[str]:
    if scene is None:
        return
    total = scene["rms"] ** 2
    share = {key: scene[f"{key}_rms"] ** 2 / total if total > 0 else 0.0 for key in ("determined", "null", "finer")}
    yield ""
    count = f"{scene['determined_directions']} of {scene['directions']} directions of light"
    yield f"in photographs of the scene, at {scene['noise']:.3g} noise ({count} determined)"
    yield _row(("relit RMS", _number(scene["relit_rms_255"]), "of 255"))
    yield _row(
        ("determined", _number(scene["determined_rms"]), f"RMS radiance; {share['determined']:.1%} of the square")
    )
    yield _row(("null space", _number(scene["null_rms"]), f"{share['null']:.1%}"))
    yield _row(("finer than texels", _number(scene["finer_rms"]), f"{share['finer']:.1%}"))


def _sphere_lines(result: dict[str, Any]) -> Iterator[str]:
    spheres = result["spheres"]
    yield ""
    yield f"{'spheres':<18}{'RMSE':>11}{'si-RMSE':>11}{'light x':>11}{'norm-RMSE':>11}{'RGB angle':>11}"
    for name in MATERIALS:
        score = spheres[name]
        values = (score[key] for key in ("rmse", "si_rmse", "scale", "norm_rmse", "angle"))
        yield f"  {name:<16}" + "".join(f"{_number(value):>11}" for value in values)


def _row(cells: tuple[str, str, str]) -> str:
    name, value, remark = cells
    return f"  {name:<18}{value:>10}  {remark}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1%}"


def _list(values: list[float | None], form: str) -> str:
    if len({*values}) == 1 and values[0] is not None:
        return format(values[0], form)
    return ", ".join("-" if value is None else format(value, form) for value in values)
