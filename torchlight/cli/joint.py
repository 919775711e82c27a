"""`torchlight joint`: several photographs of one light in, one light out, and what each photograph added."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from torchlight import doubts
from torchlight.analysis.added import Added, Determined, added
from torchlight.analysis.sampling import random_rotations
from torchlight.batch.ending import unusable_channels
from torchlight.batch.looking import shown
from torchlight.cli import arguments, fail
from torchlight.cli.progress import progress_bar
from torchlight.config import Config, Method
from torchlight.errors import ConfigError, FormatError, SolveError, TorchlightError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.scales import DOUBTFUL
from torchlight.io.atomic import check_writable
from torchlight.io.exif import Exif
from torchlight.io.files import read_bytes, sha256_of
from torchlight.io.images import read_photo
from torchlight.io.scene_file import load_scene
from torchlight.io.views_file import ESTIMATE, EXIF, Pictured, read_views
from torchlight.joint import (
    JointEstimate,
    View,
    check_views,
    explain_together,
    explain_together_robustly,
    side_by_side,
    with_confidence,
)
from torchlight.light.bases import Basis
from torchlight.method import named_device, named_method
from torchlight.observing import check_lit, empty_plane, linearize, observe, placed, visible_part
from torchlight.photo.observation import Observation
from torchlight.precomputation import dense_resolution, precompute, transport_key
from torchlight.report.joint_folder import Asked, Source, write_joint
from torchlight.solvers import Solver
from torchlight.transfer import Transfer

RESOLUTION = 32  # of the transports whose nullity is told, as in `torchlight analyze`
BANDWIDTH_MAX, ROTATIONS, SEED, NOISE = 12, 100, 0, 0.01


@dataclass(frozen=True, eq=False)
class Read:
    """One photograph of the call as its files say.

    Attributes:
        pictured: what the views file says of it.
        view: scene and samples; the exposure where it is a number.
        exif: what the camera wrote beside it.
        sha256: of the photograph.
        picture: of it, small, for the report (JPEG).
    """

    pictured: Pictured
    view: View
    exif: Exif
    sha256: str
    picture: bytes


def run(command: arguments.Joint) -> int:
    """Writes the light of several photographs and says how each was exposed and what it added.

    Raises:
        TorchlightError: something is wrong with the call, a file or a photograph; it is named, and nothing is written.
    """
    check_place(command)
    settings = command.settings
    basis, solver = named_method(whole(settings))
    device = named_device(settings.compute.device, solver)
    pictured = read_views(command.views)
    photos = [item.photo for item in pictured]
    read = with_exif([read_view(item, photos, device) for item in pictured])
    views = [item.view for item in read]
    check_views(views)
    check_different(read)
    transfers = [transfer_of(item, dense_resolution(basis, solver), command) for item in read]
    joint = solved(views, [transfer.to(device) for transfer in transfers], basis, solver, settings.solver.robust)
    told = what_was_added(read, joint, command)
    asked = Asked(settings.light.method, settings.solver.name, BANDWIDTH_MAX, ROTATIONS, NOISE)
    origins = sources(read)
    write_joint(command.out, joint, origins, told, asked, command.overwrite)
    report(command, origins, joint, told)
    return 0


def check_place(command: arguments.Joint) -> None:
    """Raises FormatError where the results would not be writable or would replace something else."""
    check_writable(command.out.parent)
    if not os.path.lexists(command.out):
        return
    if not command.overwrite:
        raise FormatError(f"{command.out}: already there; pass --overwrite to replace it, or choose another --out")
    if not (command.out / "joint.json").is_file():
        raise FormatError(f"{command.out}: not a joint result, so --overwrite leaves it; choose another --out")


def whole(settings: Method) -> Config:
    """Returns the tree of `torchlight estimate` with these settings in it."""
    return Config(settings.light, settings.adaptive, settings.solver, compute=settings.compute)


def warn(photo: Path, doubt: str) -> None:
    """Says in one line what is doubtful about a photograph, if anything is."""
    if doubt:
        fail(f"warning: {photo}: {doubt}")


def read_view(pictured: Pictured, photos: Sequence[Path], device: torch.device) -> Read:
    """Returns one photograph's samples; errors name the photograph or its scene file."""
    scene = load_scene(pictured.scene)
    stored = read_photo(pictured.photo)
    try:
        here = placed(scene, stored, str(pictured.photo))
        visible = visible_part(here)
        empty = empty_plane(here, visible, photos)
        observation = observe(linearize(stored, here), here, visible, empty)
        check_lit(observation)
        warn(pictured.photo, doubts.stretched(stored, here))
        warn(pictured.photo, doubts.tone_mapped(stored, observation, here))
    except TorchlightError as error:
        named = str(pictured.photo) in str(error) or str(pictured.scene) in str(error)
        raise error if named else type(error)(f"{pictured.photo}: {error}") from error
    parts = (observation.samples, observation.weights, observation.rejections)
    seen = Observation(*(part.to(device) for part in parts))
    scale = pictured.exposure if isinstance(pictured.exposure, float) else None
    return Read(pictured, View(here, seen, scale), stored.exif, stored.sha256, shown(stored, here))


def with_exif(read: Sequence[Read]) -> list[Read]:
    """Returns the photographs with the exposures that EXIF records where they ask for them, the first of them as 1.

    Raises:
        ConfigError: one records no exposure time, or other quantities than the others.
    """
    asking = [item for item in read if item.pictured.exposure == EXIF]
    if not asking:
        return list(read)
    first = asking[0]
    for item in asking:
        if item.exif.exposure is None:
            raise ConfigError(f"{item.pictured.photo}: its EXIF records no exposure time; write exposure: estimate")
        if item.exif.missing != first.exif.missing:
            more = " and ".join(sorted(set(item.exif.missing) ^ set(first.exif.missing)))
            names = f"{first.pictured.photo} and {item.pictured.photo}"
            raise ConfigError(f"{more}: recorded by only one of {names}; write exposure: estimate")
    if first.exif.missing:
        fail(f"note: EXIF records no {' and no '.join(first.exif.missing)}; taken as the same for all photographs")
    unit = first.exif.exposure or 1.0
    return [exposed(item, (item.exif.exposure or unit) / unit) if item in asking else item for item in read]


def check_different(read: Sequence[Read]) -> None:
    """Raises ConfigError where two photographs are the same file's content: that is one measurement."""
    first: dict[str, Path] = {}
    for item in read:
        photo = item.pictured.photo
        same = first.setdefault(item.sha256, photo)
        if same is not photo:
            raise ConfigError(f"{photo}: the same photograph as {same}, byte for byte; a photograph counts once")


def exposed(item: Read, scale: float) -> Read:
    """Returns the photograph with an exposure."""
    return replace(item, view=replace(item.view, scale=scale))


def transfer_of(item: Read, resolution: int, command: arguments.Joint) -> Transfer:
    """Returns the transport of a photograph's scene; errors name the scene file."""
    use_cache = not command.settings.compute.no_cache
    try:
        with progress_bar(f"transport of {item.pictured.scene.name}") as progress:
            return precompute(item.view.scene, resolution, use_cache=use_cache, progress=progress)
    except TorchlightError as error:
        raise type(error)(f"{item.pictured.scene}: {error}") from error


def solved(
    views: Sequence[View],
    transfers: Sequence[Transfer],
    basis: Basis,
    solver: Solver | AdaptiveHaar,
    robust: bool,
) -> JointEstimate:
    """Returns the light of all photographs.

    Raises:
        SolveError: there is none.
    """
    scenes: list[Scene] = [view.scene for view in views]
    solve = explain_together_robustly if robust else explain_together
    poses = side_by_side(scenes, transfers, solver)
    joint = solve(views, poses, basis, solver)
    unusable = unusable_channels(joint.estimate)
    if unusable:
        raise SolveError(f"the photographs together: {unusable}")
    return with_confidence(joint, poses, solver)


def what_was_added(read: Sequence[Read], joint: JointEstimate, command: arguments.Joint) -> Added:
    """Returns what the photographs determine alone and together, of the samples that were used."""
    transfers = [transfer_of(item, RESOLUTION, command) for item in read]
    used = [(view.observation.weights > 0).cpu() for view in joint.views]
    return added(transfers, used, BANDWIDTH_MAX, random_rotations(ROTATIONS, SEED), NOISE)


def sources(read: Sequence[Read]) -> list[Source]:
    """Returns where the photographs and their exposures come from."""
    named = {ESTIMATE: "estimated", EXIF: "exif"}
    origins = [named.get(str(item.pictured.exposure), "given") for item in read]
    if set(origins) == {"estimated"}:
        origins[0] = "unit"
    return [source(item, origin) for item, origin in zip(read, origins, strict=True)]


def source(item: Read, origin: str) -> Source:
    """Returns where a photograph and its exposure come from."""
    scene = item.pictured.scene
    return Source(
        item.pictured.photo, scene, item.sha256, sha256_of(read_bytes(scene)), origin, item.exif, item.picture
    )


def report(command: arguments.Joint, origins: Sequence[Source], joint: JointEstimate, told: Added) -> None:
    """Prints the exposure and the fit of every photograph, what they determine, and what is doubtful."""
    for index, origin in enumerate(origins):
        scale, deviation = joint.scales.values[index].item(), joint.scales.deviations[index].item()
        found = f"{scale:.4g} +- {100 * deviation:.2g} %" if deviation > 0 else f"{scale:.4g}"
        print(f"{origin.photo}: exposure {found} ({origin.exposure_from}), RMS {joint.rms_255[index]:.2f} of 255")
        if deviation > DOUBTFUL:
            fail(f"warning: {origin.photo}: its exposure is uncertain by {deviation:.0%}; better state it")
        own = replace(joint.estimate, observation=joint.views[index].observation, predicted=joint.predicted[index])
        warn(origin.photo, doubts.poorly_explained(own))
        warn(origin.photo, doubts.rejections(own))
    if not joint.scales.converged:
        fail(f"warning: the exposures had not settled after {joint.scales.rounds} solves")
    bandwidth = told.telling_bandwidth()
    print(f"{origins[0].photo.name} alone: {in_words(told.together[0], bandwidth)}")
    for count, found in enumerate(told.together[1:], start=2):
        print(f"{count} photographs together: {in_words(found, bandwidth)}")
    if len({transport_key(view.scene, RESOLUTION, 1) for view in joint.views}) == 1:
        fail("note: all photographs show the object in one pose: together they lower the noise and add nothing else")
    print(f"{command.out}: the light of {len(origins)} photographs")


def in_words(found: Determined, bandwidth: int) -> str:
    """Returns what photographs determine, in a line."""
    return (
        f"harmonics up to B = {found.curve.recommended()}, {found.undetermined(bandwidth):.1f} of {bandwidth**2} "
        f"undetermined at B = {bandwidth}; {found.seen.share(found.seen.determined):.0%} of the upper hemisphere "
        f"determined at 16x16, {found.seen.degrees_of_freedom:.0f} degrees of freedom at {100 * NOISE:.2g} % noise"
    )
