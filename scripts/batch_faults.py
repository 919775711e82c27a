"""Shows what a batch survives: killed at random moments, and with faults injected. Prints a table of each.

    python scripts/batch_faults.py --kills 20 --photos 60
    python scripts/batch_faults.py --only faults

Everything lies in a temporary folder; every batch is `torchlight batch` in processes of its own, one thread each.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Literal

import tyro
from faults.injected import FAULTS, Outcome
from faults.kills import Struck, pace, struck
from faults.small_batch import METHODS, made


def main(
    kills: int = 20,
    photos: int = 60,
    seed: int = 1,
    only: Literal["kills", "faults"] | None = None,
    method: Literal["texels", "adaptive"] | None = None,
) -> int:
    """Prints the tables and returns 0 where everything is as it should be, else 1.

    Args:
        kills: moments at which the parent is killed, for each method.
        photos: in the batch that is killed.
        seed: of the moments.
        only: one of the two tables.
        method: of the kills; both where it is not given.
    """
    good = True
    with tempfile.TemporaryDirectory(prefix="batch-faults-") as name:
        if only != "faults":
            for chosen in METHODS if method is None else (method,):
                good &= show_kills(Path(name), chosen, kills, photos, seed)
        if only != "kills":
            good &= show_faults(Path(name))
    return 0 if good else 1


def show_kills(folder: Path, method: str, kills: int, photos: int, seed: int) -> bool:
    """Prints what came of the kills and returns whether that is as it should be."""
    case = made(folder / method, method, photos)
    usual = pace(case, folder / method / "undisturbed")
    print(
        f"{method}: {photos} photographs; undisturbed {usual.start:.1f} s to the first, {usual.work:.1f} s from then on"
    )
    found = struck(case, folder / method / "out", folder / method / "undisturbed", kills, seed, usual)
    for line, value in rows(found):
        print(f"  {line:<52} {value}")
    return found.good


def rows(found: Struck) -> list[tuple[str, str]]:
    """Returns the lines of the table of kills."""
    return [
        ("parents killed at work / calls until done", f"{found.parents} / {found.rounds}"),
        ("workers killed before them", str(found.workers)),
        ("listings of the output by the observer", f"{found.looks:,}"),
        ("visible and not complete", said(found.partial)),
        ("complete folders written again", said(found.rewritten)),
        ("photographs with more than one line in the journal", said(found.twice)),
        ("hidden things left when all is done", said(found.left)),
        (f"files that differ from the undisturbed run, of {found.files}", said(found.different)),
    ]


def said(names: list[str]) -> str:
    """Returns how many there are and the first of them."""
    return f"{len(names)}" + (f" ({', '.join(names[:3])})" if names else "")


def show_faults(folder: Path) -> bool:
    """Prints what came of each fault and returns whether that is as it should be."""
    outcomes: list[Outcome] = []
    for number, fault in enumerate(FAULTS):
        outcomes += [fault(folder / f"fault-{number}")]
        one = outcomes[-1]
        print(f"{'ok ' if one.good else 'NOT'} {one.fault:<44} {one.happened}", flush=True)
    print(f"{sum(one.good for one in outcomes)} of {len(outcomes)} faults end as they should")
    return all(one.good for one in outcomes)


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
