"""report.html of one photograph: what went in, what came out, and how far it can be trusted, on one page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchlight.drawing.content import DIVERGING
from torchlight.fates import CHANNELS, COLOURS, NAMES
from torchlight.fit import REJECTED
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.refinement import Fate
from torchlight.pipeline import Estimate
from torchlight.preview import encode_png
from torchlight.report import panels
from torchlight.report.colours import SEQUENTIAL, bar, rules
from torchlight.report.jpegs import size_of_jpeg
from torchlight.report.markup import data_uri, document, facts, figure, grid, listed, paragraph, picture, section, text
from torchlight.report.solving import angles, peaks, solve_numbers

RESIDUAL = "Residual: predicted - observed, in luminance. Purple: predicted too bright. Orange: too dark."
MARKS = "Hatched: less than half of fine structure is determined. Crossed: not observed. "
STOPS = 10.0  # the slider's reach, each way


def photo_files(
    photo: bytes, receiver: Receiver, estimate: Estimate, result: Mapping[str, Any], scale: float
) -> dict[str, bytes]:
    """Returns report.html and thumbnail.jpg of a photograph.

    Args:
        photo: as `jpegs.photograph` gives it.
        receiver: of its scene.
        estimate: of it.
        result: what result.json holds.
        scale: the exposure to begin with: the factor from radiance to linear picture values.
    """
    radiance = panels.small_light(estimate.light)
    return {
        "report.html": photo_page(photo, receiver, estimate, result, scale),
        "thumbnail.jpg": panels.thumbnail(photo, radiance, scale),
    }


def photo_page(photo: bytes, receiver: Receiver, estimate: Estimate, result: Mapping[str, Any], scale: float) -> bytes:
    """Returns report.html of a photograph; the same bytes for the same result."""
    name, radiance = Path(result["photo"]).name, panels.small_light(estimate.light)
    body = [
        f"<header><h1>{text(name)}</h1>",
        paragraph(summary(result), "lead"),
        warned(result["warnings"]),
        "</header><main>",
        section("evidence", "What was seen, and what the light explains", *evidence(photo, receiver, estimate, name)),
        section("light", "The light", *lights(estimate, result, radiance, scale)),
        section("confidence", "How far it can be trusted", *trust(estimate, result, radiance)),
        *refinement(estimate, result),
        section("numbers", "Numbers", facts(numbers(result)), peaks(result)),
        section("provenance", "Where it comes from", facts(provenance(result)), versions(result)),
        "</main>",
    ]
    return document(f"{name}: light from its shadow", body, "light.js", rules())


def summary(result: Mapping[str, Any]) -> str:
    """Returns how it went, in a sentence or two."""
    rms = "not measured" if result["rms_255"] is None else f"{result['rms_255']:.2f} of 255"
    ended = "" if set(result["status"]) == {"converged"} else " The solver stopped short: see the certificates."
    where = ""
    if result["peak_direction"] is not None:
        azimuth, elevation = angles(result["peak_direction"])
        where = (
            f" The strongest source is at azimuth {azimuth:.1f} and elevation {elevation:.1f} degrees and brings "
            f"{result['peak_share']:.0%} of the light on the plane."
        )
    return f"The light explains the photograph with an error of {rms} on {result['visible']} samples.{where}{ended}"


def warned(warnings: Sequence[str]) -> str:
    """Returns the warnings, where there are some."""
    if not warnings:
        return ""
    return f'<div class="warnings" role="note"><strong>Warnings</strong>{listed(warnings)}</div>'


def evidence(photo: bytes, receiver: Receiver, estimate: Estimate, name: str) -> Iterator[str]:
    """Yields the photograph, the rectified observation, the prediction and the residual."""
    *shown, limit = panels.receiver_pictures(estimate.observation, estimate.predicted, receiver)
    size = receiver.samples
    observed, predicted, residual = (encode_png(pixels) for pixels in shown)
    about = "Seen from above, x to the right and y up."
    yield '<div class="panels grid">'
    yield figure(picture(photo, f"The photograph {name}", size_of_jpeg(photo), "jpeg"), "The photograph.")
    yield figure(picture(observed, "The receiver as the photograph shows it, rectified", size), f"Observed. {about}")
    yield figure(picture(predicted, "The receiver under the recovered light", size), "Predicted: what the light casts.")
    middle = bar(DIVERGING, (f"-{limit:.1f}", "0", f"+{limit:.1f} of 255"))
    yield figure(picture(residual, "The difference of predicted and observed", size), RESIDUAL, middle)
    yield "</div>"
    yield key([("#8c8c8c", "not used"), *((colour, label) for _, colour, label in left_out(estimate))])


def left_out(estimate: Estimate) -> Iterator[tuple[int, str, str]]:
    """Yields number, colour and name of the samples that the camera sees and that were left out, by reason."""
    for why, (colour, label) in REJECTED.items():
        count = int((estimate.observation.rejections == why).sum())
        if count:
            yield count, colour, f"{label}: {count} samples"


def key(entries: Sequence[tuple[str, str]]) -> str:
    """Returns the legend of some colours."""
    swatch = '<svg viewBox="0 0 10 10" aria-hidden="true"><rect width="10" height="10" fill="{}" stroke="#777"/></svg>'
    return '<ul class="key">' + "".join(f"<li>{swatch.format(c)}{text(n)}</li>" for c, n in entries) + "</ul>"


def lights(
    estimate: Estimate, result: Mapping[str, Any], radiance: Float[Tensor, "3 height width"], scale: float
) -> Iterator[str]:
    """Yields the light as two views that a slider exposes."""
    height, width = radiance.shape[-2:]
    code = panels.light_code(radiance, estimate.confidence)
    asked = "" if estimate.confidence is None else f' data-threshold="{result["confidence"]["determined_from"]}"'
    yield (
        '<div class="controls"><label>Exposure '
        f'<input type="range" id="exposure" min="-{STOPS}" max="{STOPS}" step="0.25" value="0"></label>'
        '<output id="stops" for="exposure">0.0 stops</output>'
        '<label><input type="checkbox" id="marks" checked> Mark what was not determined</label></div>'
    )
    yield '<div class="light">'
    yield figure(
        f'<canvas id="map" width="{width}" height="{height}" role="img" data-scale="{scale:.9g}"{asked} '
        f'data-light="{data_uri(encode_png(code))}" aria-label="The light in all directions, as a lat-long picture">'
        "Your browser draws no canvas; light.png shows the light.</canvas>",
        "All directions: the zenith above, the plane's horizon at half height; the middle looks along +x, the left "
        f"quarter along +y. {'' if estimate.confidence is None else MARKS}{fill_sentence(result)}",
    )
    yield figure(
        '<canvas id="disc" class="disc" width="420" height="420" role="img" '
        'aria-label="The upper hemisphere, the zenith in the middle"></canvas>',
        "The upper hemisphere, areas kept: the zenith in the middle, +x to the right, +y up, the horizon at the rim.",
    )
    yield "</div><noscript><p>The two views need JavaScript; light.png beside this page does not.</p></noscript>"
    yield paragraph(f"Values are {result['light_is']}, linear Rec.709. light.exr holds them exactly.", "quiet")


def fill_sentence(result: Mapping[str, Any]) -> str:
    """Returns what stands where nothing was determined."""
    return "" if result["fill"] == "none" else f"What was not observed is filled ({result['fill']})."


def trust(estimate: Estimate, result: Mapping[str, Any], radiance: Float[Tensor, "3 height width"]) -> Iterator[str]:
    """Yields what the photograph determines and how far noise moves the light."""
    found = estimate.confidence
    if found is None:
        yield paragraph("Not asked (--skip-confidence).")
        return
    said = result["confidence"]
    middle = said["deviation_median"]
    yield paragraph(
        f"At {said['noise']:.2%} noise {said['degrees_of_freedom']:.0f} numbers per channel are determined, and "
        f"structure as fine as {said['texels_per_edge']} texels along a cube edge over "
        f"{said['determined_share']:.0%} of the upper hemisphere."
        + (
            ""
            if middle is None
            else f" Over half of that hemisphere noise moves the radiance by less than {middle:.2g} of its mean."
        )
    )
    size = (radiance.shape[-1], radiance.shape[-2] // 2)
    first, second = panels.observability_picture(found), panels.deviation_picture(found, radiance)
    yield '<div class="wide">'
    yield figure(
        picture(encode_png(first), "Observability of the upper hemisphere, as a lat-long picture", size),
        "Observability: the share of structure as fine as a texel that comes back; horizon below, +x in the middle.",
        bar(SEQUENTIAL, ("0", "0.5", "1")),
    )
    yield figure(
        picture(encode_png(second), "Predicted deviation of the radiance, as a lat-long picture", size),
        "Predicted deviation of the mean radiance of each square, over the light's mean; grey: not observed.",
        bar(SEQUENTIAL, ("0.001", "0.01", "0.1", "1", "10")),
    )
    yield "</div>"
    yield paragraph(
        "The deviation is what noise does to the radiance of the squares that the light is made of. It does not know "
        "what varies within a square, nor a wrong object, lens or reference.",
        "quiet",
    )


def refinement(estimate: Estimate, result: Mapping[str, Any]) -> Iterator[str]:
    """Yields the squares that an adaptive light is made of, and why they are not finer."""
    if estimate.refinement is None:
        return
    both = zip(estimate.refinement.kept.cpu(), estimate.refinement.fate.cpu(), strict=True)
    drawn: dict[bytes, list[str]] = {}
    size = (1, 1)
    for channel, (kept, fate) in enumerate(both):
        pixels = panels.fates_faces(kept, fate, estimate.basis.resolution)
        size = (pixels.shape[1], pixels.shape[0])
        drawn.setdefault(panels.faces_png(pixels), []).append(
            CHANNELS[channel] if channel < len(CHANNELS) else str(channel)
        )
    shown = {Fate(value) for value in estimate.refinement.fate.unique().tolist()}
    pictures = [
        figure(
            picture(png, f"Squares of constant light, {', '.join(names)}", size), f"{', '.join(names).capitalize()}."
        )
        for png, names in drawn.items()
    ]
    yield section(
        "refinement",
        "How fine it is, and why no finer",
        paragraph(
            "The faces of the cube map, unfolded, seen from inside: +y, +x, -y, -x side by side, +z above +x. Light is "
            "constant on each square; its colour says why it is not cut further."
        ),
        key([(COLOURS[fate], NAMES[fate]) for fate in Fate if fate in shown]),
        f'<div class="wide grid faces">{"".join(pictures)}</div>',
        *fates(result),
    )


def fates(result: Mapping[str, Any]) -> Iterator[str]:
    """Yields a table per channel: how many supports of each level met which fate."""
    for name, levels in zip(CHANNELS, result["fates"] or [], strict=False):
        if levels:
            head = [column.replace("_", " ") for column in levels[0]]
            table = grid(f"Supports by level and fate, {name}", head, [list(level.values()) for level in levels])
            yield f"<details><summary>{text(f'Table of {name}')}</summary>{table}</details>"


def numbers(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields the figures that judge the fit."""
    yield "Error", "-" if result["rms_255"] is None else f"RMS {result['rms_255']:.3f} of 255"
    yield "Error, relative", "-" if result["rms_relative"] is None else f"{result['rms_relative']:.3%}"
    yield "Samples used", f"{result['visible']} of {result['points']} ({result['visible_share']:.1%})"
    yield "Left out", ", ".join(f"{count} {why}" for why, count in result["rejected"].items())
    yield from solve_numbers(result)
    yield "Near light", near(result["near_light"])
    yield "Clipped in light.png", f"{result['preview_clipped_flux']:.0%} of the flux"


def near(found: Mapping[str, Any] | None) -> str:
    """Returns whether the light is near, in words."""
    if found is None:
        return "not asked, or not to be told"
    if not found["near"]:
        return "no sign of it"
    return f"yes: its direction drifts by {found['drift_degrees']:.1f} degrees over the receiver"


def provenance(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields where a result comes from."""
    yield "Photograph", result["photo"]
    yield "SHA-256 of the photograph", result["photo_sha256"]
    yield "SHA-256 of the scene", result["scene_sha256"]
    yield "Light", f"{result['light_is']}, {result['units']}"
    yield "Filled", result["fill"]
    yield "Reference", result["reference"]
    exposure = [f"{name} {value:g}" for name, value in result["exposure"].items() if value is not None]
    yield "Exposure by EXIF", ", ".join(exposure) or "not recorded"
    yield "Camera", "as the scene says" if result["camera"] is None else f"found from its board, rms {rms(result)} px"
    yield "Object", "as the scene says" if result["placement"] is None else "placed by the photograph; see result.json"
    yield "Convention", result["convention"]


def rms(result: Mapping[str, Any]) -> str:
    """Returns how far a found camera's corners are off."""
    value = result["camera"].get("rms")
    return "-" if value is None else f"{value:.2f}"


def versions(result: Mapping[str, Any]) -> str:
    """Returns the versions that results depend on."""
    lines = ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    return f"<details><summary>Versions</summary>{paragraph(lines)}</details>"
