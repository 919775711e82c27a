"""`torchlight cache list|clear`: the transports kept on disk."""

from __future__ import annotations

from torchlight.cli import arguments
from torchlight.io import cache


def run(command: arguments.Cache) -> int:
    """Prints the cache's entries, or removes them and prints what that freed."""
    if command.action == "clear":
        print(f"{cache.cache_folder()}: {cache.clear() / 2**20:.1f} MiB freed")
        return 0
    entries = cache.entries()
    for entry in entries:
        print(f"{entry.key}  {entry.size / 2**20:8.1f} MiB")
    total = sum(entry.size for entry in entries)
    print(
        f"{cache.cache_folder()}: {len(entries)} entries, {total / 2**20:.1f} of {cache.size_limit() / 2**20:.0f} MiB"
    )
    return 0
