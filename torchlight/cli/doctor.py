"""`torchlight doctor`: what a bug report needs to know."""

from __future__ import annotations

from importlib.metadata import distributions

import torch

from torchlight.cli import arguments
from torchlight.geometry.embree import backend
from torchlight.io import cache
from torchlight.results import versions
from torchlight.threads import thread_count


def run(command: arguments.Doctor) -> int:
    """Prints one fact a line, and a warning where several OpenCV wheels overwrite each other."""
    for name, found in versions().items():
        print(f"{name:32} {found}")
    print(f"{'visibility':32} {backend()}, {thread_count()} threads")
    print(f"{'GPU':32} {torch.cuda.get_device_name() if torch.cuda.is_available() else 'none'}")
    folder = cache.cache_folder()
    print(f"{'cache':32} {folder}, {len(cache.entries())} entries, limit {cache.size_limit() / 2**30:.1f} GiB")
    wheels = opencv_wheels()
    print(f"{'OpenCV wheels':32} {', '.join(wheels) if wheels else 'none'}")
    if len(wheels) != 1:
        print("warning: exactly one OpenCV wheel should be installed; several overwrite each other. Uninstall all of")
        print("         them, then: pip install opencv-contrib-python-headless")
    return 0


def opencv_wheels() -> list[str]:
    """Returns the installed distributions that bring a cv2 module, with versions."""
    found = {(dist.metadata["Name"] or "").lower(): dist.version for dist in distributions()}
    return [f"{name} {version}" for name, version in sorted(found.items()) if name.startswith("opencv")]
