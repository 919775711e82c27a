"""The work on one block, in whatever process it happens: read, look, solve, write; each photograph ends, one way."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from torchlight.batch.blocks import Block
from torchlight.batch.ending import Ended, failure, nearness, solved, write
from torchlight.batch.looking import Looked, look
from torchlight.batch.scenes import Shared, prepare, with_mask
from torchlight.config import Config
from torchlight.io.batch_folder import PHOTOS
from torchlight.io.images import Photo, read_photo
from torchlight.io.journal import Record
from torchlight.io.manifest import Entry
from torchlight.pipeline import Estimate
from torchlight.transfer import Transfer

try:
    import resource
except ImportError:  # Windows
    resource = None

SCENES_KEPT = 2


@dataclass(frozen=True)
class Task:
    """What the blocks of a batch have in common: where results go, and the settings."""

    out: Path
    config: Config


@dataclass(frozen=True)
class Report:
    """What came of a block.

    Attributes:
        records: how each wanted photograph ended.
        seconds: by stage.
        peak_bytes: most memory that the process has held so far.
    """

    records: tuple[Record, ...]
    seconds: Mapping[str, float]
    peak_bytes: int


def folder_of(out: Path, name: str) -> Path:
    """Returns the folder of a photograph."""
    return out / PHOTOS / name


def complete(out: Path, name: str) -> bool:
    """Returns whether a photograph's folder is there: folders appear whole."""
    return (folder_of(out, name) / "result.json").is_file()


def work(task: Task, block: Block, dense: Transfer | None = None) -> Report:
    """Returns what came of a block, its results on the disk; no photograph stops the others.

    Args:
        task: what all blocks have in common.
        block: the photographs.
        dense: the scene's transport where it is there already; None = made here.
    """
    spent: dict[str, float] = {}
    try:
        with counted(spent, "scene"):
            shared = prepared(block.entries[0].scene, task.config, keeps(task, block), dense)
    except Exception as error:  # noqa: BLE001 (a batch outlives whatever one scene or photograph does)
        return report([record(entry, Ended(entry.photo, failure(error))) for entry in block.pending], spent)
    ended = dict(each(task, shared, block, spent))
    return report([record(entry, ended[entry.name]) for entry in block.pending], spent)


def report(records: Sequence[Record], spent: Mapping[str, float]) -> Report:
    """Returns the report of a block."""
    return Report(tuple(records), dict(spent), peak_bytes())


def peak_bytes() -> int:
    """Returns the most memory that this process has held; 0 where the system does not tell."""
    if resource is None:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def record(entry: Entry, ended: Ended) -> Record:
    """Returns a photograph's line of the journal."""
    state = "failed" if ended.reason else "done"
    return Record(entry.name, entry.digest, state, ended.reason)


def keeps(task: Task, block: Block) -> bool:
    """Returns whether a scene's transport is kept on the disk: where the batch has more photographs of it."""
    return block.shared and not task.config.compute.no_cache


_PREPARED: OrderedDict[tuple[Path, Config], Shared] = OrderedDict()


def prepared(scene: Path, config: Config, use_cache: bool, dense: Transfer | None = None) -> Shared:
    """Returns what photographs of a scene share; a process keeps the last ones."""
    key = (scene, config)
    if key not in _PREPARED:
        _PREPARED[key] = prepare(scene, config, use_cache=use_cache, dense=dense)
        while len(_PREPARED) > SCENES_KEPT:
            _PREPARED.popitem(last=False)
    _PREPARED.move_to_end(key)
    return _PREPARED[key]


def each(task: Task, shared: Shared, block: Block, spent: dict[str, float]) -> Iterator[tuple[str, Ended]]:
    """Yields how the photographs of a block ended, by name."""
    looked: dict[str, Looked] = {}
    reading = read_ahead([entry.photo for entry in block.entries])
    for entry, (_, stored) in zip(block.entries, reading, strict=True):
        try:
            with counted(spent, "read"):
                photo = stored.result()
            with counted(spent, "look"):
                looked[entry.name] = look(with_mask(shared.setting, entry.mask), entry.photo, photo, entry.exposure)
        except Exception as error:  # noqa: BLE001
            yield entry.name, Ended(entry.photo, failure(error))
    name_of = {id(one): name for name, one in looked.items()}
    for group, one, estimate, seconds in solved_or_not(shared, list(looked.values())):
        spent["solve"] = spent.get("solve", 0.0) + seconds
        name = name_of[id(one)]
        if name not in block.wanted:
            continue
        if isinstance(estimate, Exception):
            yield name, Ended(one.photo, failure(estimate), warnings=one.warnings)
        else:
            yield name, written(folder_of(task.out, name), (group, one, estimate, seconds), spent)


def read_ahead(files: Sequence[Path]) -> Iterator[tuple[Path, Future[Photo]]]:
    """Yields files with their reading, which goes on beside what the caller does with the one before."""
    with ThreadPoolExecutor(1) as reader:
        following: Future[Photo] | None = None
        for index, file in enumerate(files):
            current = reader.submit(read_photo, file) if following is None else following
            ahead = files[index + 1 : index + 2]
            following = reader.submit(read_photo, ahead[0]) if ahead else None
            yield file, current


def solved_or_not(shared: Shared, looked: list[Looked]) -> Iterator[tuple[Shared, Looked, Estimate | Exception, float]]:
    """Yields each photograph's estimate; where solving together fails, each alone, or what stopped it."""
    try:
        yield from list(solved(shared, looked))
    except Exception as together:  # noqa: BLE001
        if len(looked) == 1:
            yield shared, looked[0], together, 0.0
            return
        for one in looked:
            yield from solved_or_not(shared, [one])


def written(folder: Path, found: tuple[Shared, Looked, Estimate, float], spent: dict[str, float]) -> Ended:
    """Writes one photograph's folder and returns how that ended; what lies there complete already is left."""
    shared, one, estimate, seconds = found
    try:
        with counted(spent, "near test"):
            near = nearness(shared, one)
        with counted(spent, "write"):
            return write(folder, shared, one, estimate, near, seconds)
    except Exception as error:  # noqa: BLE001
        if (folder / "result.json").is_file():  # by a process that was given up too early
            return Ended(one.photo, warnings=one.warnings)
        return Ended(one.photo, failure(error), warnings=one.warnings)


@contextmanager
def counted(spent: dict[str, float], stage: str) -> Iterator[None]:
    """Adds the seconds spent in a block, however it ends, to a stage's."""
    start = time.perf_counter()
    try:
        yield
    finally:
        spent[stage] = spent.get(stage, 0.0) + time.perf_counter() - start
