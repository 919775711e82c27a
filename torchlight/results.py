"""What comes out: one folder per photograph, complete or absent."""

from __future__ import annotations

import functools
import json
import platform
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from safetensors.torch import save
from torch import Tensor

from torchlight import metrics
from torchlight.camera import Camera
from torchlight.confidence import filled, trusted, write_confidence
from torchlight.drawing.elsewhere import drawn
from torchlight.fates import fates_content
from torchlight.fit import fit_content
from torchlight.geometry.scene import Scene
from torchlight.inversion.quadtree import quadtree
from torchlight.inversion.refinement import NAMES, Fate, Refinement, fate_counts
from torchlight.io.atomic import partial_folder, write_atomically
from torchlight.io.exif import Exif
from torchlight.io.files import one_line
from torchlight.io.lights import write_light
from torchlight.io.rgbe import write_hdr
from torchlight.light.environment import EnvironmentMap, negative_share
from torchlight.light.peaks import Peaks
from torchlight.light_plane import LightPlane
from torchlight.marking import marked_light
from torchlight.near_light.verdict import NearLight
from torchlight.photo.observation import Observation, Rejection
from torchlight.pipeline import Estimate
from torchlight.placement.report import Placement
from torchlight.preview import Preview, preview, to_srgb8
from torchlight.solvers import Status
from torchlight.threads import ordered_map

LIGHT_KEYS = ("method", "resolution", "photo_sha256", "scene_sha256", "light_is", "fill")
CONVENTION = "torchlight: Z up, row 0 = zenith, image centre looks along +X (Blender's lat-long)"
Pictures = Mapping[str, Callable[[], bytes]]
Pages = Callable[[Estimate, Mapping[str, Any], float], Mapping[str, bytes]]
ZERO = 1e-9  # of the largest coefficient: counted as nonzero above it
LIBRARIES = (
    "torchlight",
    "torch",
    "kornia",
    "numpy",
    "numba",
    "trimesh",
    "embreex",
    "OpenEXR",
    "opencv-contrib-python-headless",
)


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from.

    Attributes:
        scene_sha256: of the scene file.
        photo_sha256: of the photograph.
        photo: its path as given.
        method: texels, haar, adaptive or sh.
        solver: nnls, ridge or adam.
        seconds: by stage.
        exif: what the camera wrote beside the photograph.
        placement: how far the object was moved; None where that was not asked for.
        camera: of the photograph; None where it is rectified.
        near: what the photograph tells of the distance of its light; None where that was not asked or cannot be told.
        warnings: what is to be said of the photograph, one line each.
        fill: what the light has where nothing was determined: none, constant or smooth.
    """

    scene_sha256: str
    photo_sha256: str
    photo: str
    method: str
    solver: str
    seconds: Mapping[str, float]
    exif: Exif = field(default_factory=Exif)
    placement: Placement | None = None
    camera: Camera | None = None
    near: NearLight | None = None
    warnings: tuple[str, ...] = ()
    fill: str = "none"


def select(estimate: Estimate, item: int) -> Estimate:
    """Returns the estimate of one photograph of a batch."""
    solution = estimate.solution
    fields = ("coefficients", "status", "steps", "relative_residual", "kkt_residual", "gap")
    return Estimate(
        light=light_of(estimate.light, item),
        solution=replace(solution, **{name: getattr(solution, name)[item] for name in fields}),
        basis=estimate.basis,
        observation=of_item(estimate.observation, item),
        predicted=estimate.predicted[item],
        peaks=Peaks(estimate.peaks.directions[item], estimate.peaks.shares[item]),
        refinement=None if estimate.refinement is None else of_photo(estimate.refinement, item),
        noise=None if estimate.noise is None else estimate.noise[item],
    )


def light_of(light: EnvironmentMap, item: int) -> EnvironmentMap:
    """Returns the light of one photograph of a batch."""
    radiance = light.radiance[item]
    return replace(light, radiance=radiance, nonnegative=bool((radiance >= 0).all()))


def of_item(observation: Observation, item: int) -> Observation:
    """Returns what one photograph of a batch showed."""
    rejected = None if observation.rejected is None else observation.rejected[item]
    return Observation(observation.samples[item], observation.weights[item], rejected)


def of_photo(refinement: Refinement, item: int) -> Refinement:
    """Returns the decisions for one photograph of a batch."""
    return Refinement(refinement.kept[item], refinement.fate[item], refinement.regions[item])


def write_result(
    folder: Path,
    estimate: Estimate,
    scene: Scene,
    provenance: Provenance,
    overwrite: bool = False,
    pictures: Pictures | None = None,
    pages: Pages | None = None,
) -> dict[str, Any]:
    """Writes the folder of one photograph and returns what result.json holds.

    light.exr, light.hdr and light.png (the light), the pictures, estimate.safetensors, result.json, timing.json; where
    the estimate has its confidence, confidence.exr.

    Args:
        folder: to write.
        estimate: of one photograph.
        scene: of the photograph.
        provenance: where the result comes from.
        overwrite: replace an existing folder.
        pictures: what waits for PNG files, by name; None = `evidence`.
        pages: makes further files, by name, of the estimate (its light filled), of what result.json holds, and of
            the factor from radiance to the values of light.png.

    Raises:
        FormatError: the folder exists and `overwrite` is False, or it cannot be written.
    """
    pictures = evidence(estimate, scene, provenance) if pictures is None else pictures
    shown = preview(estimate.light)
    estimate = replace(estimate, light=filled(estimate.light, estimate.confidence, provenance.fill))
    result = {**summary(estimate, scene, provenance), "preview_clipped_flux": shown.clipped_flux}
    with partial_folder(folder, overwrite=overwrite) as partial:
        made = (  # the longest first, and last what another process may be drawing
            lambda: write_all(partial, {} if pages is None else pages(estimate, result, shown.scale)),
            *lights(partial, estimate, shown, result),
            lambda: write_all(partial, {name: wait() for name, wait in pictures.items()}),
        )
        deque(ordered_map(lambda write: write(), made), maxlen=0)
        write_json(partial / "timing.json", {"seconds": dict(provenance.seconds)})
        write_json(partial / "result.json", result)
    return result


def lights(folder: Path, estimate: Estimate, shown: Preview, result: Mapping[str, Any]) -> Iterator[Callable[[], None]]:
    """Yields what writes the light: light.exr, light.hdr, light.png, confidence.exr and estimate.safetensors."""
    light, confidence = estimate.light, estimate.confidence
    metadata = {key: result[key] for key in LIGHT_KEYS}
    yield lambda: write_light(folder / "light.exr", light, metadata)
    yield lambda: write_atomically(folder / "light.png", marked(shown, estimate, result["fill"]))
    if confidence is not None:
        yield lambda: write_confidence(folder / "confidence.exr", confidence, light.height, metadata)
    yield lambda: write_hdr(folder / "light.hdr", light.radiance)  # torchlight's convention, 0 for negative
    yield lambda: write_atomically(folder / "estimate.safetensors", save(tensors(estimate)))


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes files by their names."""
    for name, data in files.items():
        write_atomically(folder / name, data)


def marked(shown: Preview, estimate: Estimate, fill: str) -> bytes:
    """Returns light.png of an estimate; where it has its confidence, what was not determined is marked."""
    if estimate.confidence is None:
        return shown.png
    unfilled = fill == "none"
    picture = shown.pixels.copy() if unfilled else to_srgb8(estimate.light.radiance.detach().cpu() * shown.scale)
    return marked_light(picture, estimate.confidence, fill)


def evidence(estimate: Estimate, scene: Scene, provenance: Provenance) -> Pictures:
    """Returns what waits for the pictures of an estimate: fit.png and, of the adaptive method, refinement.png."""
    rms, used = number(estimate.rms_255), visibility(estimate.observation)["visible"]
    title = f"{one_line(Path(provenance.photo).name, 80)}: RMS {rms:.2f} of 255, {used} samples"
    fit = fit_content(estimate.observation, estimate.predicted, scene.receiver, scene.units, title)
    if estimate.refinement is None:
        return {"fit.png": drawn(fit)}
    fates = fates_content(estimate.refinement, estimate.basis.resolution)
    return {"fit.png": drawn(fit), "refinement.png": drawn(fates)}


def tensors(estimate: Estimate) -> dict[str, Tensor]:
    """Returns what estimate.safetensors holds: coefficients, status and the observation they explain.

    Of the adaptive method also `kept` (functions in use) and `fate` (of every support).
    """
    named = {
        "coefficients": estimate.solution.coefficients,
        "status": estimate.solution.status,
        "samples": estimate.observation.samples,
        "weights": estimate.observation.weights,
        "predicted": estimate.predicted,
    }
    if estimate.refinement is not None:
        named |= {"kept": estimate.refinement.kept, "fate": estimate.refinement.fate}
    return {name: tensor.detach().cpu().contiguous() for name, tensor in named.items()}


def summary(estimate: Estimate, scene: Scene, provenance: Provenance) -> dict[str, Any]:
    """Returns the figures of one photograph's estimate, ready for JSON (NaN as null)."""
    observation = estimate.observation
    return {
        "photo": provenance.photo,
        "rms_255": number(estimate.rms_255),
        "rms_relative": number(metrics.rms_relative(estimate.predicted, observation.samples, observation.weights)),
        **visibility(observation),
        "rejected": rejected(observation),
        "saturated_samples": "dropped",
        **found_light(estimate, provenance.method, provenance.solver),
        "confidence": trusted(estimate.confidence, estimate.light),
        "fill": provenance.fill,
        "reference": scene.reference,
        "occluder_albedo": scene.occluder_albedo,
        "light_plane": stands(estimate.light.plane, provenance.near),
        "units": "relative",
        "light_is": light_is(scene),
        "exposure": recorded(provenance.exif),
        "camera": seen_from(provenance.camera),
        "near_light": distance_of(provenance.near),
        "warnings": list(provenance.warnings),
        "placement": None if provenance.placement is None else asdict(provenance.placement),
        "length_unit": scene.units,
        "convention": CONVENTION,
        "photo_sha256": provenance.photo_sha256,
        "scene_sha256": provenance.scene_sha256,
        "versions": versions(),
    }


def found_light(estimate: Estimate, method: str, solver: str) -> dict[str, Any]:
    """Returns how the light was found, how well that ended, and where it is brightest, ready for JSON."""
    solution, coefficients = estimate.solution, estimate.solution.coefficients
    largest = coefficients.abs().amax(dim=-1, keepdim=True)
    peaks = found_peaks(estimate.peaks)
    return {
        "method": method,
        "resolution": estimate.basis.resolution,
        "solver": solver,
        "coefficients": estimate.basis.size,
        "nonzero": ((coefficients.abs() > ZERO * largest).sum(dim=-1)).tolist(),
        **size_of_light(estimate.refinement, estimate.basis.resolution),
        "noise": None if estimate.noise is None else number(estimate.noise),
        "nonnegative": estimate.light.nonnegative,
        "negative_flux": number(negative_share(estimate.light)),
        "status": [Status(value).name.lower() for value in solution.status.tolist()],
        "steps": solution.steps.tolist(),
        "kkt_residual": [number(value) for value in solution.kkt_residual],
        "gap": [number(value) for value in solution.gap],
        "peak_direction": peaks[0]["direction"] if peaks else None,
        "peak_share": peaks[0]["share"] if peaks else None,
        "peaks": sorted(peaks[1:], key=lambda peak: -peak["share"]),
    }


def size_of_light(refinement: Refinement | None, resolution: int) -> dict[str, Any]:
    """Returns functions in use, regions of constant light and fates of supports per channel; None for a whole basis."""
    if refinement is None:
        return {"functions": None, "regions": None, "fates": None}
    return {
        "functions": refinement.functions.tolist(),
        "regions": refinement.regions.tolist(),
        "fates": [level_table(resolution, kept, fate) for kept, fate in channels_of(refinement)],
    }


def channels_of(refinement: Refinement) -> Iterator[tuple[Tensor, Tensor]]:
    """Yields the functions in use and the fates of every channel."""
    yield from zip(refinement.kept.cpu(), refinement.fate.cpu(), strict=True)


def level_table(resolution: int, kept: Tensor, fate: Tensor) -> list[dict[str, int]]:
    """Returns, from coarse to fine, how many of a level's supports met which fate; a level without any is left out."""
    counts = fate_counts(quadtree(resolution), kept, fate)
    return [
        {"level": level, **{NAMES[name].replace(" ", "_").replace("-", "_"): int(row[name]) for name in Fate}}
        for level, row in enumerate(counts)
        if int(row.sum()) > 0
    ]


def visibility(observation: Observation) -> dict[str, Any]:
    """Returns how many samples are used, of how many, and their ratio."""
    visible, points = int((observation.weights > 0).sum()), observation.weights.shape[-1]
    return {"visible": visible, "points": points, "visible_share": visible / points}


def rejected(observation: Observation) -> dict[str, int]:
    """Returns how many samples that the camera sees were left out, by `Rejection`."""
    return {why.name.lower(): int((observation.rejections == why).sum()) for why in Rejection if why}


def distance_of(near: NearLight | None) -> dict[str, Any] | None:
    """Returns whether the light is near and how far its direction drifts; drift and distances only where it is."""
    if near is None:
        return None
    if not near.flagged:
        return {"near": False, "p_value": near.p_value}
    return {
        "near": True,
        "p_value": near.p_value,
        "drift_degrees": near.drift_degrees,
        "drift_deviation_degrees": near.deviation_degrees,
        "distance": near.distance,
        "height": near.height,
    }


def stands(plane: LightPlane | None, near: NearLight | None) -> dict[str, Any] | None:
    """Returns where the light was taken to stand, and whether that was found in the photograph; None = far away."""
    if plane is None:
        return None
    return {**asdict(plane), "estimated": near is not None and near.height == plane.height}


def seen_from(camera: Camera | None) -> dict[str, Any] | None:
    """Returns a pose that was found from the board in the photograph, and how sure it is; else None."""
    if camera is None or camera.sighting is None:
        return None
    return {"world_to_camera": camera.world_to_camera.tolist(), **asdict(camera.sighting)}


def found_peaks(peaks: Peaks) -> list[dict[str, Any]]:
    """Returns direction and share of the flux of every peak there is, that of the brightest element first."""
    both = zip(peaks.directions.tolist(), peaks.shares.tolist(), strict=True)
    return [{"direction": direction, "share": share} for direction, share in both if share > 0]


def light_is(scene: Scene) -> str:
    """Returns what the recovered radiance is relative to."""
    known = scene.receiver.albedo is not None or scene.albedo_map is not None
    return "radiance x exposure" if known else "radiance x albedo x exposure"


def recorded(exif: Exif) -> dict[str, float | None]:
    """Returns the exposure that EXIF records, None where it does not; `scale` is what pixels are proportional to."""
    return {"time": exif.time, "aperture": exif.aperture, "iso": exif.iso, "scale": exif.exposure}


def versions() -> dict[str, str]:
    """Returns the versions that results depend on; "absent" for what is not installed."""
    return {"python": platform.python_version(), **{name: installed(name) for name in LIBRARIES}}


@functools.cache
def installed(name: str) -> str:
    """Returns the version of a distribution, or "absent"; looked up once, since it takes milliseconds."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def number(value: Tensor) -> float | None:
    """Returns a scalar tensor as a float, None for NaN or infinity (JSON has neither)."""
    scalar = float(value)
    return scalar if abs(scalar) < float("inf") else None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes readable JSON, complete or not at all."""
    write_atomically(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())
