"""`torchlight view`: a scene, its light and its shadow in the browser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from torchlight.cli import arguments
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError
from torchlight.geometry.scene import Scene
from torchlight.io.files import read_bytes, sha256_of
from torchlight.io.lights import read_light
from torchlight.io.result_folder import ResultFolder, read_result
from torchlight.io.scene_file import load_scene
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.precomputation import precompute
from torchlight.relighting import lit_by
from torchlight.viewer.stage import Stage, everything, manageable, of_results
from torchlight.viewer.window import close_window, open_window, viser_module

MAX_RESOLUTION = 64


def run(command: arguments.View) -> int:
    """Serves the window until it is interrupted."""
    viser_module()
    check(command)
    shown = prepare(command)
    server = open_window(shown, command.host, command.port)
    try:
        place = "localhost" if command.host in ("0.0.0.0", "::", "") else command.host  # noqa: S104
        print(f"open http://{place}:{server.get_port()} in a browser; Ctrl-C ends", flush=True)
        wait()
    except KeyboardInterrupt:
        print("closed")
    finally:
        close_window(server)
    return 0


def wait() -> None:
    """Returns never; Ctrl-C interrupts it."""
    while True:
        time.sleep(0.2)


def check(command: arguments.View) -> None:
    """Raises ConfigError for options out of range, or what cannot be shown together."""
    if not 0 < command.port < 65536:
        raise ConfigError(f"--port: expected 1 to 65535, got {command.port}")
    if not 2 <= command.resolution <= MAX_RESOLUTION or command.resolution % 2:
        raise ConfigError(f"--resolution: expected an even number from 2 to {MAX_RESOLUTION}, got {command.resolution}")
    if command.source.is_dir() and command.scene is None:
        raise ConfigError(f"{command.source}: a folder of results does not hold its scene; add --scene SCENE")
    if not command.source.is_dir() and command.scene is not None:
        raise ConfigError(f"{command.source}: --scene goes with a folder of results; this is none")
    if not command.source.exists():
        raise FormatError(f"{command.source}: no such file or folder; name a scene file or a folder of results")


def prepare(command: arguments.View) -> Stage:
    """Returns what is to be shown."""
    path = command.source if command.scene is None else command.scene
    scene = load_scene(path)
    found = read_result(command.source) if command.scene is not None else None
    light = chosen_light(command, found)
    scene = lit_by(scene, light)
    with progress_bar(f"transport of {path.name}") as progress:
        transfer = precompute(scene, command.resolution, use_cache=not command.no_cache, progress=progress)
    points = scene.receiver.points
    seen = None if found is None else of_results(found.tensors, points)
    observed, used = (None, everything(points)) if seen is None else seen
    lines = facts(command, path, scene, found, observed is not None)
    return Stage(scene, manageable(light), transfer, observed, used, lines)


def chosen_light(command: arguments.View, found: ResultFolder | None) -> EnvironmentMap:
    """Returns the light that is named, else that of the results, else a built-in sky."""
    if command.light is not None:
        return read_light(command.light, command.convention)
    return sun_and_window() if found is None else found.light


def facts(
    command: arguments.View, path: Path, scene: Scene, found: ResultFolder | None, compared: bool
) -> tuple[str, ...]:
    """Returns lines to show beside the picture; Markdown."""
    columns, rows = scene.receiver.samples
    lines = [f"**{path.name}**: {len(scene.triangles)} triangles, {columns} x {rows} samples"]
    if command.light is not None:
        lines.append(f"light: {command.light.name}")
    elif found is None:
        lines.append("light: built-in sky")
    if found is None:
        return tuple(lines)
    result: dict[str, Any] = found.result
    rms = result.get("rms_255")  # of their own light
    explained = f", RMS {rms:.3g} of 255" if command.light is None and isinstance(rms, float) else ""
    lines.append(f"photograph: {Path(str(result.get('photo'))).name}{explained}")
    if result.get("scene_sha256") != sha256_of(read_bytes(path)):
        lines.append(f"**{path.name} is not the file that these results were made with**")
    if not compared:
        lines.append("the photograph's samples are not those of this scene: not shown")
    return tuple(lines)
