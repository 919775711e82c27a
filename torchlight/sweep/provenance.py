"""Where figures come from: versions, and the commit of the code that made them."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import torchlight

SECONDS = 10


@cache
def git_commit() -> str | None:
    """Returns the commit of torchlight's checkout, "<hash>+changes" where files differ; None where there is none."""
    package = Path(torchlight.__file__).parent
    if git(package, "ls-files", "--error-unmatch", "__init__.py") is None:
        return None  # installed, perhaps below somebody else's repository
    commit = git(package, "rev-parse", "HEAD")
    changes = git(package, "status", "--porcelain", "--", ".")
    return None if commit is None else commit + ("+changes" if changes else "")


def git(folder: Path, *words: str) -> str | None:
    """Returns what a git command says in a folder; None where it fails, or git is not there."""
    try:
        done = subprocess.run(  # noqa: S603
            ["git", "-C", str(folder), *words],  # noqa: S607
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
