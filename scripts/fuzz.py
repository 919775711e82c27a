"""Reads wrong inputs of every kind: each must be read or refused in one line, in bounded time and memory.

    python scripts/fuzz.py --count 10000 --seed 1

Inputs are valid ones with seeded mutations, and small ones that ask for much. They are read in a process of its own
with an end to its memory; one that hangs or crashes costs that process alone. Prints a table by kind, and what was
wrong; an input that was wrong stays in --keep.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import tyro
from fuzzing.bombs import bombs
from fuzzing.mutations import mutated
from fuzzing.pool import VALID, Reader
from fuzzing.seeds import seeds
from fuzzing.trial import readers


def main(count: int = 10_000, seed: int = 1, keep: Path = Path("fuzz-found"), only: str = "") -> int:
    """Prints what came of the inputs and returns 0 where all is well, else 1.

    Args:
        count: inputs.
        seed: of the mutations.
        keep: folder for inputs that were wrong.
        only: part of a kind's name; empty = all kinds.
    """
    ended: Counter[tuple[str, str]] = Counter()
    wrong: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        (Path(name) / VALID).mkdir()
        valid = seeds(Path(name) / VALID)
        for file, data in valid.items():
            (Path(name) / VALID / file).write_bytes(data)
        with Reader(Path(name)) as reader:
            for kind, file, data in inputs(valid, count, seed, only):
                said = reader.read(file, data)
                good = said in ("read", "refused")
                ended[kind, said if good else "wrong"] += 1
                if not good and kept(keep, file, data, f"{file}: {said}", wrong):
                    print(f"WRONG {kind}: {said}", flush=True)
    show(ended)
    return 1 if wrong else 0


def inputs(valid: dict[str, bytes], count: int, seed: int, only: str) -> Iterator[tuple[str, str, bytes]]:
    """Yields kind, file name and content of every input: those that ask for much, then mutations in turn."""
    chosen = [(f"bomb: {what}", *bomb) for what, bomb in bombs(valid).items() if only in bomb[0]]
    yield from chosen
    names = [name for name in valid if only in name and readers(name)]
    for index in range(max(0, count - len(chosen))):
        name = names[index % len(names)]
        yield name, name, mutated(random.Random(f"{seed} {index}"), name, valid[name])


def kept(folder: Path, file: str, data: bytes, said: str, wrong: Counter[str]) -> bool:
    """Writes an input that was wrong in a way not seen before, and returns whether it was one."""
    alike = "".join(letter for letter in said if not letter.isdigit())[:120]
    wrong[alike] += 1
    if wrong[alike] > 1:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{len(wrong):03d}-{file}").write_bytes(data)
    return True


def show(ended: Counter[tuple[str, str]]) -> None:
    """Prints how many inputs of each kind were read, refused or wrong."""
    kinds = list(dict.fromkeys(kind for kind, _ in ended if not kind.startswith("bomb")))
    print(f"{'kind':<72} {'read':>6} {'refused':>8} {'wrong':>6}")
    for kind in kinds:
        print(f"{kind:<72} {ended[kind, 'read']:>6} {ended[kind, 'refused']:>8} {ended[kind, 'wrong']:>6}")
    for what in ("read", "refused", "wrong"):
        asked = [kind.removeprefix("bomb: ") for kind, said in ended if said == what and kind.startswith("bomb")]
        print(
            f"inputs that ask for much, {what}: {len(asked)}" + (f" ({'; '.join(asked)})" if what != "refused" else "")
        )
    print(f"{sum(ended.values()):,} inputs, {sum(n for (_, said), n in ended.items() if said == 'wrong')} wrong")


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
