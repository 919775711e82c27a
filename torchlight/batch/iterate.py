"""Photographs in a program of your own: an estimate each, as they come, with bounded memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from torchlight.batch.blocks import PHOTOS_PER_SOLVE
from torchlight.batch.ending import failure, unusable_channels
from torchlight.batch.looking import Looked, look
from torchlight.batch.scenes import prepare
from torchlight.batch.work import read_ahead, solved_or_not
from torchlight.config import Config
from torchlight.pipeline import Estimate


@dataclass(frozen=True, eq=False)
class Found:
    """What came of one photograph.

    Attributes:
        photo: the file.
        estimate: light and evidence; None where there is none.
        reason: why not, one line; empty where there is an estimate.
        warnings: what is to be said of the photograph.
    """

    photo: Path
    estimate: Estimate | None
    reason: str = ""
    warnings: tuple[str, ...] = ()


def estimate(photos: Iterable[str | Path], scene: str | Path, config: Config | None = None) -> Iterator[Found]:
    """Yields what came of each photograph, in their order; one that cannot be used is data, not an exception.

    Photographs are read beside the solving and solved in blocks of `PHOTOS_PER_SOLVE`, so that memory does not grow.

    Args:
        photos: files of photographs of one scene; may be endless.
        scene: its scene file.
        config: the settings; None = the defaults.

    Raises:
        TorchlightError: the scene or a setting cannot be used.
    """
    shared = prepare(Path(scene), Config() if config is None else config)
    remaining = map(Path, photos)
    while files := list(islice(remaining, PHOTOS_PER_SOLVE)):
        found: dict[int, Found] = {}
        looked: dict[int, Looked] = {}
        for place, (file, reading) in enumerate(read_ahead(files)):
            try:
                looked[place] = look(shared.setting, file, reading.result())
            except Exception as error:  # noqa: BLE001 (one photograph never stops the others)
                found[place] = Found(file, None, failure(error))
        places = {id(one): place for place, one in looked.items()}
        for _, one, solved, _ in solved_or_not(shared, list(looked.values())):
            why = failure(solved) if isinstance(solved, Exception) else unusable_channels(solved)
            result = None if isinstance(solved, Exception) or why else solved
            found[places[id(one)]] = Found(one.photo, result, why, one.warnings)
        yield from (found[place] for place in range(len(files)))
