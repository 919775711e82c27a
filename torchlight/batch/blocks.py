"""Which photographs are solved together: always the same ones, whatever was done before and on however many machines.

Sums in floating point depend on what they are made together with. Blocks follow from the manifest alone, so that a
batch which was interrupted, or cut into shards, ends with the same bits as one that was not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

from torchlight.errors import ConfigError
from torchlight.io.journal import Record
from torchlight.io.manifest import Entry

PHOTOS_PER_SOLVE = 8  # results appear block by block; the exact solver gains nothing from more at once


@runtime_checkable
class Piece(Protocol):
    """Work for one process, that an engine may have to do again in smaller parts."""

    def parts(self) -> Sequence[Any]:
        """Returns the same work cut as small as it goes, each of the same class."""
        ...

    def lost(self, why: str) -> tuple[Record, ...]:
        """Returns the records of work that ends without an answer."""
        ...


@dataclass(frozen=True)
class Block:
    """Photographs of one scene that are solved together.

    Attributes:
        entries: the photographs.
        wanted: names of those that are to be written; the others are complete already.
        shared: the batch has more photographs of the scene than these, so its transport is worth keeping.
    """

    entries: tuple[Entry, ...]
    wanted: frozenset[str]
    shared: bool

    @property
    def pending(self) -> tuple[Entry, ...]:
        """The photographs that are to be written."""
        return tuple(entry for entry in self.entries if entry.name in self.wanted)

    def parts(self) -> Sequence[Block]:
        """Returns a block per photograph that is to be written."""
        return [replace(self, entries=(entry,), wanted=frozenset({entry.name})) for entry in self.pending]

    def lost(self, why: str) -> tuple[Record, ...]:
        """Returns the failures of all photographs that are to be written."""
        return tuple(Record(entry.name, entry.digest, "failed", f"{entry.photo}: {why}") for entry in self.pending)


@dataclass(frozen=True)
class Shard:
    """Part `index` of `count` of a batch, counted from 1."""

    index: int = 1
    count: int = 1

    @property
    def name(self) -> str:
        """Of its journal."""
        return f"shard-{self.index}-of-{self.count}"


WHOLE = Shard()


def named_shard(text: str) -> Shard:
    """Returns the shard that a text such as "3/8" names.

    Raises:
        ConfigError: it names none.
    """
    index, slash, count = text.partition("/")
    if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise ConfigError(f"--shard: expected i/n with 1 <= i <= n, such as 3/8, got '{text}'; shards count from 1")
    return Shard(int(index), int(count))


def blocks(entries: Sequence[Entry], shard: Shard, wanted: frozenset[str]) -> list[Block]:
    """Returns the blocks of a shard that have something to write.

    Photographs of a scene stay in the manifest's order, in blocks of `PHOTOS_PER_SOLVE`; blocks are dealt to the
    shards in turn.
    """
    by_scene: dict[str, list[Entry]] = {}
    for entry in entries:
        by_scene.setdefault(str(entry.scene), []).append(entry)
    parts = [
        (alike[start : start + PHOTOS_PER_SOLVE], len(alike) > PHOTOS_PER_SOLVE)
        for alike in by_scene.values()
        for start in range(0, len(alike), PHOTOS_PER_SOLVE)
    ]
    dealt = [
        Block(tuple(part), wanted.intersection(entry.name for entry in part), shared)
        for part, shared in parts[shard.index - 1 :: shard.count]
    ]
    return [block for block in dealt if block.wanted]
