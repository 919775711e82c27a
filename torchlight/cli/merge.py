"""`torchlight merge`: exposure brackets in, one linear picture and its mask out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.cli import arguments, fail
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import check_writable
from torchlight.io.exif import Exif
from torchlight.io.exr import write_exr
from torchlight.io.images import Photo, read_photo, write_png
from torchlight.io.response_file import read_response, write_response
from torchlight.photo.alignment import shift_between
from torchlight.photo.brackets import Exposed, exposed, exposed_linear, merge
from torchlight.photo.radiometry import DEFAULT_GAMMA, Response, tabulated
from torchlight.photo.response import CODES, estimate_response

Progress = Callable[[int, int], None]
SAMPLED = 4096  # pixels of every photograph that the response and the check of exposures look at
MOST_SHIFT = 1  # pixels
DOUBTED = 1.25  # a factor between the exposure that pixels say and the one that is stated
WELL_EXPOSED, FEWEST = (0.2, 0.9), 50  # stored values that tell an exposure, and how many of them it takes


@dataclass(frozen=True, eq=False)
class Bracket:
    """What all steps need to know of the photographs without holding them.

    Attributes:
        files: the photographs.
        bits: 8 or 16, None for float files.
        exif: of each.
        sample: stored values of some pixels spread over the picture.
    """

    files: tuple[Path, ...]
    bits: int | None
    exif: tuple[Exif, ...]
    sample: Float[Tensor, "photos 3 rows columns"]


def run(command: arguments.Merge) -> int:
    """Writes the merged picture, its mask and an estimated response, and says what they hold."""
    check_request(command)
    with progress_bar("reading") as progress:
        bracket = survey(command.photos, progress)
    exposures = stated_times(command) or recorded_exposures(bracket)
    response = chosen_response(command.response, bracket, exposures)
    report_doubts(bracket, exposures, response)
    with progress_bar("merging") as progress:
        merged = merge(exposed_one_by_one(bracket, exposures, response, progress))
    metadata = {"exposures": list(exposures), "photos": [file.name for file in command.photos]}
    if command.response == "estimate" and response is not None:
        write_response(beside(command.out, "_response.json"), response)
    write_png(beside(command.out, "_mask.png"), (merged.usable * 255).byte().numpy())
    write_exr(command.out, merged.radiance, metadata)
    stops = math.log2(max(exposures) / min(exposures))
    share = merged.usable.float().mean()
    print(
        f"{command.out}: {len(exposures)} photographs over {stops:.1f} stops, {share:.1%} of the pixels measured; "
        f"use {beside(command.out, '_mask.png').name} as the scene's mask"
    )
    return 0


def check_request(command: arguments.Merge) -> None:
    """Raises ConfigError or FormatError where the call cannot end well, before any photograph is read."""
    if len(command.photos) < 2:
        raise ConfigError("at least two photographs are needed; usage: torchlight merge PHOTO PHOTO... --out hdr.exr")
    if command.out.suffix.lower() != ".exr":
        raise ConfigError(f"--out {command.out}: expected a name that ends in .exr")
    check_writable(command.out.parent)
    written = [command.out, beside(command.out, "_mask.png")]
    written += [beside(command.out, "_response.json")] if command.response == "estimate" else []
    for path in written:
        if path.exists() and not command.overwrite:
            raise FormatError(f"{path}: already there; pass --overwrite to replace it, or choose another --out")
    stated_times(command)


def beside(out: Path, ending: str) -> Path:
    """Returns the name of a file that belongs to the picture."""
    return out.with_name(out.stem + ending)


def stated_times(command: arguments.Merge) -> tuple[float, ...]:
    """Returns --times as seconds, such as 1/30,0.5,2; empty where it is not given."""
    if command.times is None:
        return ()
    times = tuple(seconds(text) for text in command.times.split(","))
    if len(times) != len(command.photos):
        raise ConfigError(f"--times: {len(times)} times for {len(command.photos)} photographs; give one each, in order")
    return times


def seconds(text: str) -> float:
    """Returns a time such as 0.5 or 1/30; ConfigError for anything else."""
    above, _, below = text.strip().partition("/")
    try:
        value = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not 0 < value < math.inf:
        raise ConfigError(f"--times: expected seconds such as 0.5 or 1/30, got '{text.strip()}'")
    return value


def survey(files: Sequence[Path], progress: Progress) -> Bracket:
    """Returns what the photographs have in common.

    Raises:
        FormatError: one cannot be read.
        ConfigError: they differ in size or depth, or the camera has moved.
    """
    first = previous = None
    exif, sample = [], []
    for index, file in enumerate(files):
        photo = read_photo(file)
        first = photo if first is None else first
        check_alike(first, photo, files[0], file)
        if previous is not None:
            check_still(previous, photo, files[index - 1], file)
        previous = photo
        exif.append(photo.exif)
        sample.append(spread(photo.pixels))
        progress(index + 1, len(files))
    return Bracket(tuple(files), None if first is None else first.bits, tuple(exif), torch.stack(sample))


def check_alike(first: Photo, photo: Photo, first_file: Path, file: Path) -> None:
    """Raises ConfigError where two photographs differ in size or depth."""
    sizes = [f"{picture.pixels.shape[2]} x {picture.pixels.shape[1]}" for picture in (first, photo)]
    if sizes[0] != sizes[1]:
        raise ConfigError(f"{file}: {sizes[1]} pixels, but {first_file} has {sizes[0]}; merge photographs of one size")
    if first.bits != photo.bits:
        kinds = ["linear float" if bits is None else f"{bits}-bit" for bits in (first.bits, photo.bits)]
        raise ConfigError(f"{file}: {kinds[1]}, but {first_file} is {kinds[0]}; merge photographs of one kind")


def check_still(first: Photo, second: Photo, first_file: Path, second_file: Path) -> None:
    """Raises ConfigError where the camera has moved between two photographs, as far as they can tell."""
    shift = shift_between(displayed(first), displayed(second))
    if shift is not None and max(map(abs, shift)) > MOST_SHIFT:
        raise ConfigError(
            f"{second_file}: moved by {shift[0]}, {shift[1]} pixels (x, y) against {first_file}; "
            "brackets need a camera on a stand: align them first, or leave it out"
        )


def displayed(photo: Photo) -> Float[Tensor, "height width"]:
    """Returns the green channel in [0, 1]; of linear files by a square root, in which shadows are wider than a code."""
    green = photo.pixels[1]
    return green if photo.bits is not None else green.clamp(0, 1).sqrt()


def spread(pixels: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 rows columns"]:
    """Returns some pixels on a regular grid."""
    step = max(1, int(math.sqrt(pixels.shape[1] * pixels.shape[2] / SAMPLED)))
    return pixels[:, step // 2 :: step, step // 2 :: step].clone()


def recorded_exposures(bracket: Bracket) -> tuple[float, ...]:
    """Returns the exposures that EXIF records; ConfigError where one is missing or says less than the others."""
    for file, exif in zip(bracket.files, bracket.exif, strict=True):
        if exif.exposure is None:
            raise ConfigError(f"{file}: its EXIF records no exposure time; pass --times 1/30,1/8,... for all in order")
        if exif.missing != bracket.exif[0].missing:
            more = " and ".join(sorted(set(exif.missing) ^ set(bracket.exif[0].missing)))
            raise ConfigError(f"{more}: recorded by only one of {bracket.files[0]} and {file}; pass --times")
    if bracket.exif[0].missing:
        fail(f"note: EXIF records no {' and no '.join(bracket.exif[0].missing)}; taken as the same for all photographs")
    return tuple(exif.exposure or math.nan for exif in bracket.exif)


def chosen_response(text: str | None, bracket: Bracket, exposures: Sequence[float]) -> Response | None:
    """Returns the response that --response names; None for linear float files, which need none."""
    if bracket.bits is None:
        if text not in (None, "linear"):
            raise ConfigError(f"--response {text}: the photographs are linear float or RAW files; leave it away")
        return None
    if text is None:
        raise ConfigError(
            f"--response: missing, and {bracket.bits}-bit photographs do not say how they encode radiance; "
            "pass srgb, linear, gamma:2.2, the file of a response, or estimate"
        )
    codes = 2**bracket.bits
    if text == "estimate":
        if codes != CODES:
            raise ConfigError(f"--response estimate: needs 8-bit photographs, these have {bracket.bits} bits; state it")
        return estimate_response(sampled_codes(bracket), torch.tensor(exposures, dtype=torch.float64))
    if text in ("srgb", "linear"):
        return tabulated(text, codes)
    if text.startswith("gamma"):
        return tabulated("gamma", codes, stated_gamma(text))
    response = read_response(text)
    if response.exposure.shape[-1] != codes:
        raise ConfigError(f"{text}: a response of {response.exposure.shape[-1]} codes; the photographs have {codes}")
    return response


def stated_gamma(text: str) -> float:
    """Returns the number of gamma:2.2, 2.2 where there is none; ConfigError for anything else."""
    _, colon, number = text.partition(":")
    try:
        value = float(number) if colon else DEFAULT_GAMMA
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf or not (colon or text == "gamma"):
        raise ConfigError(f"--response {text}: expected gamma:NUMBER, for example gamma:2.2")
    return value


def sampled_codes(bracket: Bracket) -> Int[Tensor, "photos 3 pixels"]:
    """Returns the codes of the sampled pixels."""
    return (bracket.sample * (CODES - 1)).round().int().flatten(start_dim=2)


def exposed_one_by_one(
    bracket: Bracket, exposures: Sequence[float], response: Response | None, progress: Progress
) -> Iterator[tuple[Exposed, float]]:
    """Yields each photograph with its exposure; only one is held at a time."""
    for index, (file, exposure) in enumerate(zip(bracket.files, exposures, strict=True)):
        yield said(read_photo(file).pixels, response), exposure
        progress(index + 1, len(bracket.files))


def said(pixels: Float[Tensor, "3 height width"], response: Response | None) -> Exposed:
    """Returns what a photograph says of its pixels."""
    return exposed_linear(pixels) if response is None else exposed(pixels, response)


def report_doubts(bracket: Bracket, exposures: Sequence[float], response: Response | None) -> None:
    """Says where a photograph's pixels disagree with its exposure: flicker, an automatic ISO, a wrong response."""
    looks = [said(pixels, response) for pixels in bracket.sample]
    merged = merge(zip(looks, exposures, strict=True))
    for index, (look, exposure) in enumerate(zip(looks, exposures, strict=True)):
        stored = bracket.sample[index]
        well = (stored > WELL_EXPOSED[0]) & (stored < WELL_EXPOSED[1]) & merged.usable & (merged.radiance > 0)
        if int(well.sum()) < FEWEST:
            continue
        ratio = (look.exposure[well] / exposure / merged.radiance[well]).median().item()
        if not 1 / DOUBTED < ratio < DOUBTED:
            file = bracket.files[index]
            fail(f"warning: {file}: its pixels say {ratio:.2g} times the stated exposure; is --response right?")
