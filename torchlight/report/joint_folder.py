"""What `torchlight joint` writes: one folder for the light of several photographs, complete or absent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchlight import fit, metrics
from torchlight.analysis.added import Added, Determined
from torchlight.analysis.nullity import TOLERANCE
from torchlight.confidence import trusted, write_confidence
from torchlight.fates import fates_picture
from torchlight.io.atomic import partial_folder, write_atomically
from torchlight.io.exif import Exif
from torchlight.io.files import one_line
from torchlight.io.lights import write_light
from torchlight.io.rgbe import write_hdr
from torchlight.joint import JointEstimate
from torchlight.preview import preview
from torchlight.report.joint_page import joint_page
from torchlight.results import (
    CONVENTION,
    found_light,
    light_is,
    marked,
    number,
    recorded,
    rejected,
    versions,
    visibility,
    write_json,
)


@dataclass(frozen=True)
class Source:
    """Where one of the photographs comes from.

    Attributes:
        photo: its path.
        scene: the path of its scene file.
        photo_sha256: of the photograph.
        scene_sha256: of the scene file.
        exposure_from: "given", "exif", "estimated", or "unit" of the first where all are found.
        exif: what the camera wrote beside the photograph.
        picture: of the photograph, small (JPEG).
    """

    photo: Path
    scene: Path
    photo_sha256: str
    scene_sha256: str
    exposure_from: str
    exif: Exif
    picture: bytes


@dataclass(frozen=True)
class Asked:
    """What a call asked for.

    Attributes:
        method: texels, haar, adaptive or sh.
        solver: nnls, ridge or adam.
        bandwidth_max: largest bandwidth of the nullity curves.
        rotations: of their sampling directions.
        noise: of the observability.
    """

    method: str
    solver: str
    bandwidth_max: int
    rotations: int
    noise: float


def write_joint(
    folder: Path, joint: JointEstimate, sources: Sequence[Source], told: Added, asked: Asked, overwrite: bool = False
) -> dict[str, Any]:
    """Writes the folder of a joint estimate and returns what joint.json holds.

    light.exr, light.hdr and light.png (the light), confidence.exr, fit_1.png, fit_2.png, ... (one per photograph),
    report.html, joint.json; of the adaptive method also refinement.png.

    Args:
        folder: to write.
        joint: with its confidence.
        sources: of the photographs.
        told: what each of them added.
        asked: what the call asked for.
        overwrite: replace an existing folder.

    Raises:
        FormatError: the folder exists and `overwrite` is False, or it cannot be written.
    """
    estimate = joint.estimate
    shown = preview(estimate.light)
    result = {**summary(joint, sources, told, asked), "preview_clipped_flux": shown.clipped_flux}
    fits = [fit_picture(joint, sources[index], index) for index in range(len(sources))]
    page = joint_page(joint, [item.picture for item in sources], result, shown.scale)
    with partial_folder(folder, overwrite=overwrite) as partial:
        metadata = {key: result[key] for key in ("method", "resolution", "light_is", "fill")}
        write_light(partial / "light.exr", estimate.light, metadata)
        write_hdr(partial / "light.hdr", estimate.light.radiance)  # torchlight's convention, 0 for negative
        write_atomically(partial / "light.png", marked(shown, estimate, result["fill"]))
        if estimate.confidence is not None:
            write_confidence(partial / "confidence.exr", estimate.confidence, estimate.light.height, metadata)
        for index, fit in enumerate(fits):
            write_atomically(partial / f"fit_{index + 1}.png", fit)
        if estimate.refinement is not None:
            write_atomically(partial / "refinement.png", fates_picture(estimate.refinement, estimate.basis.resolution))
        write_atomically(partial / "report.html", page)
        write_json(partial / "joint.json", result)
    return result


def fit_picture(joint: JointEstimate, source: Source, index: int) -> bytes:
    """Returns what a photograph shows, what the light predicts for it and the difference, as a PNG."""
    view = joint.views[index]
    title = (
        f"{one_line(source.photo.name, 80)}: RMS {joint.rms_255[index]:.2f} of 255, "
        f"exposure {joint.scales.values[index]:.4g} ({source.exposure_from})"
    )
    return fit.fit_picture(view.observation, joint.predicted[index], view.scene.receiver, view.scene.units, title)


def summary(joint: JointEstimate, sources: Sequence[Source], told: Added, asked: Asked) -> dict[str, Any]:
    """Returns the figures of a joint estimate, ready for JSON."""
    scenes = [view.scene for view in joint.views]
    meanings = {light_is(scene) for scene in scenes}
    return {
        "photographs": [photograph(joint, source, index) for index, source in enumerate(sources)],
        "exposure_unit": exposure_unit(sources),
        "exposure_solves": joint.scales.rounds,
        "exposures_converged": joint.scales.converged,
        **found_light(joint.estimate, asked.method, asked.solver),
        "confidence": trusted(joint.estimate.confidence, joint.estimate.light),
        "fill": "none",
        "added": added_summary(told, asked),
        "units": "relative",
        "light_is": meanings.pop() if len(meanings) == 1 else "radiance x exposure, albedo known in part",
        "length_unit": scenes[0].units,
        "convention": CONVENTION,
        "versions": versions(),
    }


def exposure_unit(sources: Sequence[Source]) -> str:
    """Returns what an exposure of 1 means."""
    origins = {source.exposure_from for source in sources}
    if "given" in origins:
        return "as given"
    return "EXIF of the first photograph that has it" if "exif" in origins else "the first photograph"


def photograph(joint: JointEstimate, source: Source, index: int) -> dict[str, Any]:
    """Returns the figures of one photograph."""
    view, shown = joint.views[index], joint.predicted[index]
    seen = view.observation
    return {
        "photo": str(source.photo),
        "scene": str(source.scene),
        "exposure": number(joint.scales.values[index]),
        "exposure_deviation": number(joint.scales.deviations[index] * joint.scales.values[index]),
        "exposure_from": source.exposure_from,
        "exif": recorded(source.exif),
        "reference": view.scene.reference,
        "occluder_albedo": view.scene.occluder_albedo,
        "weight": number(joint.trust[index]),
        "rms_255": number(joint.rms_255[index]),
        "rms_relative": number(metrics.rms_relative(shown, seen.samples, seen.weights)),
        **visibility(seen),
        "rejected": rejected(seen),
        "photo_sha256": source.photo_sha256,
        "scene_sha256": source.scene_sha256,
    }


def added_summary(told: Added, asked: Asked) -> dict[str, Any]:
    """Returns what each photograph determines alone, and the first 1, 2, ... of them together."""
    return {
        "bandwidth_max": asked.bandwidth_max,
        "rotations": asked.rotations,
        "noise": asked.noise,
        "tolerance": TOLERANCE,
        "bandwidth": told.telling_bandwidth(),
        "alone": [determined_summary(item) for item in told.alone],
        "together": [determined_summary(item) for item in told.together],
    }


def determined_summary(item: Determined) -> dict[str, Any]:
    """Returns the nullity against bandwidth at the recommended tolerance, and what is determined at 16 x 16."""
    return {
        "recommended_bandwidth": item.curve.recommended(),
        "nullity": [item.undetermined(bandwidth + 1) for bandwidth in range(item.curve.unknowns.shape[0])],
        "degrees_of_freedom": item.seen.degrees_of_freedom,
        "determined": item.seen.share(item.seen.determined),
    }
