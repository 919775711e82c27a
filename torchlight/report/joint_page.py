"""report.html of several photographs of one light: what each shows, the light of all, and how far to trust it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchlight.joint import JointEstimate
from torchlight.report import panels
from torchlight.report.colours import rules
from torchlight.report.markup import document, facts, grid, paragraph, section, text
from torchlight.report.page import evidence, lights, refinement, trust, versions
from torchlight.report.solving import peaks, solve_numbers


def joint_page(joint: JointEstimate, pictures: Sequence[bytes], result: Mapping[str, Any], scale: float) -> bytes:
    """Returns report.html of a joint estimate; the same bytes for the same result.

    Args:
        joint: the light, the photographs and what each shows under it.
        pictures: of the photographs, as `jpegs.photograph` gives them.
        result: what joint.json holds.
        scale: the exposure to begin with: the factor from radiance to linear picture values.
    """
    estimate, radiance = joint.estimate, panels.small_light(joint.estimate.light)
    heading = f"The light of {len(pictures)} photographs"
    body = [
        f"<header><h1>{text(heading)}</h1>",
        paragraph(summary(result), "lead"),
        "</header><main>",
        section("photographs", "The photographs", photographs(result)),
        *(seen(joint, picture, index, result) for index, picture in enumerate(pictures)),
        section("light", "The light", *lights(estimate, result, radiance, scale)),
        section("confidence", "How far it can be trusted", *trust(estimate, result, radiance)),
        section("added", "What each photograph added", *added(result)),
        *refinement(estimate, result),
        section("numbers", "Numbers", facts(numbers(result)), peaks(result)),
        section("provenance", "Where it comes from", facts(provenance(result)), versions(result)),
        "</main>",
    ]
    return document(f"{heading}, from its shadows", body, "light.js", rules())


def names(result: Mapping[str, Any]) -> list[str]:
    """Returns the photographs' file names."""
    return [Path(item["photo"]).name for item in result["photographs"]]


def summary(result: Mapping[str, Any]) -> str:
    """Returns how it went, in a sentence or two."""
    errors = [item["rms_255"] for item in result["photographs"] if item["rms_255"] is not None]
    worst = f" with errors of {min(errors):.2f} to {max(errors):.2f} of 255" if errors else ""
    ended = "" if set(result["status"]) == {"converged"} else " The solver stopped short: see the certificates."
    return f"One light explains {', '.join(names(result))}{worst}.{ended}"


def photographs(result: Mapping[str, Any]) -> str:
    """Returns a table of the photographs: exposure, weight and error of each."""
    head = ("photograph", "exposure", "known from", "weight", "RMS of 255", "samples used")
    rows = [
        (
            Path(item["photo"]).name,
            exposure(item),
            item["exposure_from"],
            "-" if item["weight"] is None else f"{item['weight']:.2g}",
            "-" if item["rms_255"] is None else f"{item['rms_255']:.2f}",
            f"{item['visible']} of {item['points']}",
        )
        for item in result["photographs"]
    ]
    about = f"An exposure of 1 is {result['exposure_unit']}; weight 1 counts most."
    return grid("Exposure, weight and error", head, rows) + paragraph(about, "quiet")


def exposure(item: Mapping[str, Any]) -> str:
    """Returns an exposure and, where it was found, how uncertain it is."""
    if item["exposure"] is None:
        return "-"
    deviation = item["exposure_deviation"]
    return f"{item['exposure']:.4g}" + (f" +- {deviation:.1g}" if deviation else "")


def seen(joint: JointEstimate, picture: bytes, index: int, result: Mapping[str, Any]) -> str:
    """Returns what one photograph shows, and what the light of all casts in it."""
    view, name = joint.views[index], names(result)[index]
    own = replace(joint.estimate, observation=view.observation, predicted=joint.predicted[index])
    heading = f"{name}: what was seen, and what the light explains"
    return section(f"evidence-{index + 1}", heading, *evidence(picture, view.scene.receiver, own, name))


def added(result: Mapping[str, Any]) -> Iterator[str]:
    """Yields what the photographs determine, each alone and the first of them together."""
    told, labels = result["added"], names(result)
    head = ("photographs", "numbers determined", "of the hemisphere", "harmonics up to", "unknown at that bandwidth")
    rows = [(label, *determined(item, told)) for label, item in zip(labels, told["alone"], strict=True)]
    together = list(enumerate(told["together"], start=1))[1:]
    rows += [(f"the first {count} together", *determined(item, told)) for count, item in together]
    yield grid("What the photographs determine", head, rows)
    yield paragraph(
        f"Of any light, at {told['noise']:.2%} noise: numbers per channel, and the share of the upper hemisphere over "
        "which structure as fine as 16 texels along a cube edge comes back. Harmonics: the bandwidth up to which all "
        f"are told apart, and how many of the {told['bandwidth'] ** 2} are not at bandwidth {told['bandwidth']}.",
        "quiet",
    )


def determined(item: Mapping[str, Any], told: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Returns the cells of a row of that table."""
    unknown = item["nullity"][told["bandwidth"] - 1]
    return (
        f"{item['degrees_of_freedom']:.0f}",
        f"{item['determined']:.0%}",
        f"B = {item['recommended_bandwidth']}",
        f"{unknown:.1f} of {told['bandwidth'] ** 2}",
    )


def numbers(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields the figures that judge the solve."""
    yield from solve_numbers(result)
    settled = "settled" if result["exposures_converged"] else "did not settle"
    yield "Exposures", f"{settled} after {result['exposure_solves']} solves"
    yield "Clipped in light.png", f"{result['preview_clipped_flux']:.0%} of the flux"


def provenance(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields where a result comes from."""
    for item in result["photographs"]:
        yield "Photograph", f"{item['photo']} (SHA-256 {item['photo_sha256']})"
        yield "Its scene", f"{item['scene']} (SHA-256 {item['scene_sha256']}), reference {item['reference']}"
    yield "Light", f"{result['light_is']}, {result['units']}"
    yield "Convention", result["convention"]
