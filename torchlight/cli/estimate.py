"""`torchlight estimate`: photographs in, one folder per photograph out; no photograph stops the others."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path

from torchlight.analysis.verdict import excess
from torchlight.batch.blocks import PHOTOS_PER_SOLVE
from torchlight.batch.ending import Ended, failure, nearness, solved, write
from torchlight.batch.looking import Looked, look
from torchlight.batch.scenes import Shared, prepare
from torchlight.cli import NOTHING_STARTED, arguments, fail
from torchlight.cli.progress import progress_bar
from torchlight.drawing import elsewhere
from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.io.atomic import check_writable
from torchlight.io.images import read_photo
from torchlight.light.synthesis import prepare_map
from torchlight.method import named_method
from torchlight.threads import aside, begin_beside
from torchlight.transfer import Transfer

SOME_FAILED = 1


def run(command: arguments.Estimate) -> int:
    """Returns 0 when every photograph is done, 1 when some failed, 2 when none could be used.

    Raises:
        TorchlightError: nothing could start.
    """
    check_places(command)
    get_ready(command)
    with progress_bar("transport") as progress:
        use_cache = not command.settings.compute.no_cache
        shared = prepare(command.scene, command.settings, command.photos, use_cache, progress)
    introduce(command, shared)
    usable, done = 0, 0
    for start in range(0, len(command.photos), PHOTOS_PER_SOLVE):
        looked = list(usable_ones(shared, command.photos[start : start + PHOTOS_PER_SOLVE]))
        usable += len(looked)
        done += sum(solve_and_write(command, shared, looked))
    if not usable:
        return NOTHING_STARTED
    failed = len(command.photos) - done
    if failed and len(command.photos) > 1:
        fail(f"{failed} of {len(command.photos)} photographs failed; the others are complete in {command.out}")
    return SOME_FAILED if failed else 0


def get_ready(command: arguments.Estimate) -> None:
    """Begins, on a thread of its own, what is needed only once there is light: the shares of map pixels, pictures."""

    def begin() -> None:
        with suppress(TorchlightError):  # whoever needs it will say so
            prepare_map(named_method(command.settings)[0])
            if not (command.settings.output.skip_pictures or elsewhere.begun()):
                elsewhere.load()
            if command.settings.output.reports:
                import_module("torchlight.report.page")

    begin_beside(begin)


def check_places(command: arguments.Estimate) -> None:
    """Raises ConfigError or FormatError where results would collide with each other or with what is there."""
    if not command.photos:
        raise ConfigError("no photograph given; usage: torchlight estimate SCENE PHOTO... --out DIR")
    by_stem: dict[str, Path] = {}
    for photo in command.photos:
        if photo.stem in ("", ".", ".."):
            raise ConfigError(f"{photo}: its name without suffix cannot name a folder; rename it")
        other = by_stem.setdefault(photo.stem, photo)
        if other is not photo:
            raise ConfigError(
                f"{other} and {photo} would both be written to {command.out / photo.stem}; "
                "rename one or estimate them in separate calls"
            )
    check_writable(command.out)
    existing = [command.out / stem for stem in by_stem if os.path.lexists(command.out / stem)]
    if existing and not command.overwrite:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        raise FormatError(f"{existing[0]}{more}: already there; pass --overwrite to replace, or choose another --out")
    for folder in existing:
        if not (folder / "result.json").is_file():
            raise FormatError(f"{folder}: not a result of torchlight, so --overwrite leaves it; choose another --out")


def introduce(command: arguments.Estimate, shared: Shared) -> None:
    """Says how much of the receiver the photographs can show, and what cannot be told apart."""
    visible, scene = shared.setting.visible, shared.setting.scene
    seen, points = int(visible.sum()), scene.receiver.points
    print(f"{command.scene}: {seen} of {points} samples visible ({seen / points:.1%})")
    if isinstance(shared.columns, Transfer):  # the adaptive method takes no more than the shadows determine
        too_much = excess(shared.columns, visible, shared.basis, command.settings.solver.name != "ridge")
        if too_much is not None:
            fail(f"warning: {too_much}")


def usable_ones(shared: Shared, photos: Sequence[Path]) -> Iterator[Looked]:
    """Yields what each photograph shows; a photograph that cannot be used is reported in one line and left out."""
    for photo in photos:
        try:
            looked = look(shared.setting, photo, read_photo(photo))
        except TorchlightError as error:
            say_failed(photo, str(error))
            continue
        for note in looked.notes:
            print(f"{photo}: {note}")
        yield looked


def solve_and_write(command: arguments.Estimate, shared: Shared, looked: Sequence[Looked]) -> Iterator[bool]:
    """Solves photographs together, writes each one's folder, and yields whether all went well."""
    with aside(partial(nearness, shared), looked) as answers:  # which need no light: it is sought meanwhile
        near = {one.photo: answer for one, answer in zip(looked, answers, strict=True)}
        for group, one, estimate, seconds in solved(shared, looked):
            folder = command.out / one.photo.stem
            try:
                ended = write(folder, group, one, estimate, near[one.photo](), seconds, command.overwrite)
            except TorchlightError as error:
                ended = Ended(one.photo, failure(error), warnings=one.warnings)
            say_ended(folder, ended)
            yield not ended.reason


def say_ended(folder: Path, ended: Ended) -> None:
    """Says how a photograph ended: one line, and one per doubt."""
    if ended.reason:
        say_failed(ended.photo, ended.reason)
    else:
        result = ended.result
        short = "" if set(result["status"]) == {"converged"} else "; the solver stopped short: see kkt_residual"
        print(
            f"{folder}: RMS {result['rms_255']:.2f} of 255 on {result['visible']} samples, "
            f"{result['preview_clipped_flux']:.0%} of the flux clipped in light.png{short}"
        )
    for warning in ended.warnings:
        fail(f"warning: {ended.photo}: {warning}")


def say_failed(photo: Path, reason: str) -> None:
    """Says in one line why a photograph has no result."""
    fail(reason if str(photo) in reason else f"{photo}: {reason}")
