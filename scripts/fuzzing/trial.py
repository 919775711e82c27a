"""One input read as its name says: what came of it, and what it tried to do beside."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from torchlight.batch.work import folder_of
from torchlight.errors import TorchlightError
from torchlight.io import cache
from torchlight.io.batch_folder import read_object, write_lines, write_table
from torchlight.io.cameras import read_lens, read_poses
from torchlight.io.config_file import read_config
from torchlight.io.images import image_size, read_photo
from torchlight.io.journal import records
from torchlight.io.lights import read_light, read_stored
from torchlight.io.manifest import as_row, read_entries
from torchlight.io.meshes import read_mesh
from torchlight.io.observability_file import read_observability
from torchlight.io.response_file import read_response
from torchlight.io.result_folder import read_result
from torchlight.io.scene_file import load_scene
from torchlight.io.sweep_file import read_sweep
from torchlight.io.target_file import read_target
from torchlight.io.views_file import read_views

LONGEST_LINE = 2000
_FORBIDDEN = ("pickle.find_class", "os.system", "subprocess.Popen", "os.exec", "socket.connect", "os.fork")
_CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link", "os.truncate", "os.chmod")
_CODE = (".py", ".pyc", ".so", ".nbi", ".nbc")


def read_manifest(path: Path) -> None:
    """Reads a manifest and does what a batch does with it before any photograph."""
    entries = read_entries([str(path)], Path("scene.yaml"))
    out = path.parent / "out"
    for entry in entries:
        if not Path(os.path.abspath(folder_of(out, entry.name))).is_relative_to(out / "photos"):  # noqa: PTH100
            raise AssertionError(f"{entry.name} leads outside")
    out.mkdir(exist_ok=True)
    write_lines(out / "manifest.jsonl", map(as_row, entries))
    again = read_entries([str(out / "manifest.jsonl")], None)
    if [entry.name for entry in again] != [entry.name for entry in entries]:
        raise AssertionError("a manifest written again has other names")
    write_table(out / "results.csv", [{"photo": str(entry.photo), **dict(entry.tags)} for entry in entries])


def read_picture(path: Path) -> None:
    """Reads a picture and its size, which must agree."""
    width, height = image_size(path)
    if read_photo(path).pixels.shape != (3, height, width):
        raise AssertionError("a picture of another size than its header says")


def read_journal(path: Path) -> None:
    """Reads the journals of a folder, which holds but this one."""
    records(path.parent)


def read_cached(path: Path) -> None:
    """Reads a cache file by its key."""
    with patch.dict(os.environ, {cache.FOLDER_VARIABLE: str(path.parent)}):
        cache.load(path.stem)


def read_folder(path: Path) -> None:
    """Reads the result of an estimate, of whose files this is one."""
    read_result(path.parent)


def read_transforms(path: Path) -> None:
    """Reads lens and poses."""
    read_poses(path)
    read_lens(path)


BY_NAME: Mapping[str, tuple[Callable[[Path], Any], ...]] = {
    "scene.yaml": (load_scene,),
    "views.yaml": (read_views,),
    "target.yaml": (read_target,),
    "config.yaml": (read_config,),
    "manifest.jsonl": (read_manifest,),
    "manifest.csv": (read_manifest,),
    "transforms.json": (read_transforms,),
    "camera.json": (read_lens,),
    "camera.yml": (read_lens,),
    "cameras.txt": (read_lens,),
    "response.json": (read_response,),
    "sweep.yaml": (read_sweep,),
    "light.json": (read_light, read_stored),
    "result.json": (read_folder,),
    "estimate.safetensors": (read_folder,),
    "confidence.exr": (read_observability,),
    "observability.exr": (read_observability,),
    "journal.jsonl": (read_journal,),
    "batch.json": (read_object,),
}
BY_SUFFIX: Mapping[str, tuple[Callable[[Path], Any], ...]] = {
    **dict.fromkeys((".png", ".jpg", ".tiff", ".bmp"), (read_picture,)),
    **dict.fromkeys((".exr", ".hdr"), (read_picture, read_light, read_stored)),
    **dict.fromkeys((".ply", ".obj", ".off", ".stl", ".glb", ".gltf"), (read_mesh,)),
    ".safetensors": (read_cached,),
}


def readers(name: str) -> tuple[Callable[[Path], Any], ...]:
    """Returns what reads a file of a name."""
    return BY_NAME.get(name) or BY_SUFFIX.get(Path(name).suffix, ())


def outcome(folder: Path, name: str, data: bytes) -> str:
    """Returns "read", "refused", or what is wrong.

    Args:
        folder: holds the files that inputs name; the input is written into it.
        name: says the kind of the input.
        data: the input.
    """
    path = folder / name
    path.write_bytes(data)
    said = "read"
    for reader in readers(name):
        found = one_reading(reader, path)
        said = found if found != "read" else said
        if found not in ("read", "refused"):
            return f"{reader.__name__}: {found}"
    return said


def one_reading(reader: Callable[[Path], Any], path: Path) -> str:
    """Returns what came of one reader."""
    with warnings.catch_warnings(), watched(path.parent) as wrong:
        warnings.simplefilter("ignore")
        try:
            reader(path)
            said = "read"
        except TorchlightError as error:
            said = wrong_line(str(error))
        except Exception as error:  # noqa: BLE001 (that is what is looked for)
            said = f"{type(error).__name__}: {error}"[:200]
    return wrong[0] if wrong else said


def wrong_line(line: str) -> str:
    """Returns "refused" where an error says what it should: one line, not too long, else what is wrong with it."""
    if "\n" in line or "\r" in line:
        return f"an error of several lines: {line[:100]!r}"
    if len(line) > LONGEST_LINE:
        return f"an error of {len(line)} characters"
    return "refused"


_watching: list[tuple[Path, list[str]]] = []


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Yields what code does meanwhile that no reader should: start programs, unpickle, write outside the folder."""
    if not getattr(sys, "_fuzzing_hook", False):
        sys.addaudithook(_hear)
        sys._fuzzing_hook = True  # pyright: ignore[reportAttributeAccessIssue]
    wrong: list[str] = []
    _watching.append((folder.resolve(), wrong))
    try:
        yield wrong
    finally:
        _watching.pop()


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watching:
        return
    folder, wrong = _watching[-1]
    if event.startswith(_FORBIDDEN):
        wrong.append(f"{event}{arguments}"[:200])
    elif event == "open" and _writes(arguments) and _outside(arguments[0], folder):
        wrong.append(f"writes {arguments[0]}"[:200])
    elif event in _CHANGES and _outside(arguments[0], folder):
        wrong.append(f"{event} {arguments[0]}"[:200])


def _writes(arguments: tuple[Any, ...]) -> bool:
    mode, flags = arguments[1], arguments[2]
    if isinstance(mode, str):
        return any(letter in mode for letter in "wax+")
    return bool((flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def _outside(place: Any, folder: Path) -> bool:
    if not isinstance(place, str | bytes | Path):
        return False
    path = Path(os.fsdecode(place))
    code = path.suffix in _CODE or "__pycache__" in str(path) or ".pyc" in path.name  # what Python itself keeps
    return not code and not path.resolve().is_relative_to(folder)
