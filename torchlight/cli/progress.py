"""Progress bars: shown on a terminal for work that takes more than a moment, silent elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

DELAY_SECONDS = 1.0


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[int, int], None]]:
    """Yields a function of (done, total) that draws a bar on standard error."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from tqdm import tqdm  # which makes locks and a thread for every bar, also for those it does not show

    with tqdm(
        desc=description,
        total=1,
        delay=DELAY_SECONDS,
        unit_scale=True,
        leave=False,
        bar_format="{desc} {percentage:3.0f}% |{bar:40}| {remaining} left",
    ) as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield advance
