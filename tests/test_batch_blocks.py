"""Which photographs are solved together."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchlight.batch.blocks import PHOTOS_PER_SOLVE, Shard, blocks, named_shard
from torchlight.errors import ConfigError
from torchlight.io.manifest import Entry


def entries(count: int, scenes: int) -> list[Entry]:
    return [Entry(f"{i}", Path(f"{i}.jpg"), Path(f"{i % scenes}.yaml")) for i in range(count)]


@pytest.mark.parametrize("scenes", [1, 3, 40])
def test_shards_hold_every_photograph_once_in_the_blocks_of_the_whole(scenes: int) -> None:
    asked = entries(40, scenes)
    names = frozenset(entry.name for entry in asked)
    whole = blocks(asked, Shard(), names)
    parts = [block for index in range(1, 4) for block in blocks(asked, Shard(index, 3), names)]
    assert sorted(entry.name for block in whole for entry in block.entries) == sorted(names)
    assert {block.entries for block in parts} == {block.entries for block in whole}
    assert all(len(block.entries) <= PHOTOS_PER_SOLVE for block in whole)
    assert all(len({entry.scene for entry in block.entries}) == 1 for block in whole)


def test_what_is_done_changes_no_blocks_members() -> None:
    asked = entries(20, 1)
    (left,) = blocks(asked, Shard(), frozenset({"9"}))
    whole = blocks(asked, Shard(), frozenset(entry.name for entry in asked))
    assert left.entries == whole[1].entries
    assert [entry.name for entry in left.pending] == ["9"]


def test_a_scene_of_one_block_is_not_kept() -> None:
    assert not blocks(entries(8, 1), Shard(), frozenset("0"))[0].shared
    assert blocks(entries(9, 1), Shard(), frozenset("0"))[0].shared


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "1/", "/2", "a/b", "-1/2", "1/2/3", "1.0/2", "²/3"])
def test_a_wrong_shard_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected i/n with 1 <= i <= n"):
        named_shard(text)
    assert named_shard("3/8") == Shard(3, 8)
