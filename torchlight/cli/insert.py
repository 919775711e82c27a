"""`torchlight insert`: an object into a photograph, by the light recovered from it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.analysis.observability import DETERMINED
from torchlight.cli import arguments
from torchlight.cli.outputs import check_outputs
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, SceneError, TorchlightError
from torchlight.evenness import evened
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import apply_matrix
from torchlight.insertion.placing import check_above, stood, unit_scale
from torchlight.insertion.rendering import Insertion, Rendering, insert
from torchlight.insertion.shading import Material
from torchlight.io.images import Photo, read_photo
from torchlight.io.lights import read_described
from torchlight.io.meshes import read_mesh
from torchlight.io.observability_file import observability_beside, read_observability
from torchlight.io.pictures import Storage, Untouched, check_suffix, storage_of, write_picture
from torchlight.io.scene_file import load_scene
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap, luminance, radiance_at
from torchlight.observing import linearize, placed
from torchlight.photo.observation import LinearPhoto

EVENED = "light: made even where the photograph does not tell; --as-found uses it as it is"
UNTOLD = "occluder_matt: nothing more is told by it: a rectified photograph shows no upright faces of the objects"
DARKENED = 0.01  # of a pixel's light: what counts as shadow in what is said
LEAST_CHANGE = 1e-3
ROUNDING = 1e-9  # of the object's size
DOUBTFUL = 0.1  # share of the light on upright surfaces that is said to be uncertain
OFF = 0.1  # the plane brighter or darker by more than this: the light is hardly the photograph's


def run(command: arguments.Insert) -> int:
    """Writes the pictures and says what is in them."""
    pictures = outputs(command)
    material = Material(command.albedo, command.gloss, command.roughness)
    photo = read_photo(command.photo)
    scene = placed(load_scene(command.scene), photo, str(command.photo))
    linear = linearize(photo, scene)
    found, about = read_described(command.light, command.convention)
    triangles = standing(command, scene)  # whatever is wrong is said before the work begins
    own = not command.as_found and about.get("photo_sha256") == photo.sha256
    light = made_even(linear, scene, found, command.bounce) if own else found
    referenced = scene.reference != "uniform" or scene.albedo_map is not None
    rendering = Rendering(command.rays, command.bounce, command.only_receiver, command.fit_brightness or referenced)
    with progress_bar("rendering") as progress:
        made = insert(linear, scene, light, triangles, material, rendering, progress)
    check_shown(made, triangles)
    storage = storage_of(photo, scene.encoding, scene.gamma, scene.response)
    for path, write in pictures.items():
        clipped = write(path, made, photo, storage)
        print(f"{path}: {said(made)}" if clipped is None else f"{path}: {said(made)}; {clipped:.1%} clipped")
    said_of_light = [EVENED] if light is not found else []
    said_of_light += [UNTOLD] if own and scene.occluder_matt and scene.camera is None else []
    for line in [*doubts(made, linear, rendering), *undetermined(command.light, light), *said_of_light]:
        print(line)
    return 0


def made_even(photo: LinearPhoto, scene: Scene, light: EnvironmentMap, bounce: bool) -> EnvironmentMap:
    """Returns the light even where its photograph does not tell; as it is where it stands near or is negative."""
    if light.plane is not None or not light.nonnegative:
        return light
    with progress_bar("making the light even") as progress:
        return evened(photo, scene, light, progress=progress, bounce=bounce)


def outputs(command: arguments.Insert) -> dict[Path, Callable[[Path, Insertion, Photo, Storage], float | None]]:
    """Returns the files to write and how.

    Raises:
        ConfigError: a suffix that cannot hold what is asked for.
        FormatError: a file that cannot be written.
    """
    out = command.out
    check_suffix(out, command.layer == "straight")
    if command.layer == "premultiplied" and out.suffix.lower() != ".exr":
        raise ConfigError(f"{out}: a premultiplied layer is written as .exr: the colours of a PNG are straight")
    straight = out.with_name(f"{out.stem}_straight{'.exr' if out.suffix.lower() == '.exr' else '.png'}")
    chosen = {
        "composite": {out: write_composite},
        "straight": {out: write_straight},
        "premultiplied": {out: write_premultiplied},
        "all": {
            out: write_composite,
            straight: write_straight,
            out.with_name(f"{out.stem}_premultiplied.exr"): write_premultiplied,
        },
    }[command.layer]
    check_outputs(chosen, command.overwrite)
    return chosen


def standing(command: arguments.Insert, scene: Scene) -> Float[Tensor, "faces 3 3"]:
    """Returns the object in the world.

    Raises:
        FormatError: the mesh cannot be read or has no faces.
        ConfigError: --pose is no 4 x 4 matrix, or comes with what it replaces.
        SceneError: the object lies below the plane.
    """
    mesh = read_mesh(command.object)
    scale = command.scale * (unit_scale(command.units, scene.units) if command.units is not None else 1.0)
    if command.pose is None:
        return stood(mesh, command.position, command.rotate, scale, command.up)
    if (command.position, command.rotate, command.up, scale) != ((0.0, 0.0), 0.0, "z", 1.0):
        raise ConfigError("--pose: give it alone, without --position, --rotate, --up, --scale and --units")
    try:
        triangles = apply_matrix(mesh, matrix(command.pose))
    except SceneError as error:
        raise SceneError(f"--pose: {str(error).removeprefix('matrix: ')}") from error
    try:
        check_above(triangles)
    except TorchlightError as error:
        raise type(error)(f"--pose: {error}") from error
    return triangles


def matrix(text: str) -> Float[Tensor, "4 4"]:
    """Returns a matrix from 16 numbers; raises ConfigError for anything else."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != 16:
        raise ConfigError(f"--pose: expected 16 numbers separated by commas, row by row, got '{text[:60]}'")
    return torch.tensor(values, dtype=torch.float64).reshape(4, 4)


def check_shown(made: Insertion, triangles: Float[Tensor, "faces 3 3"]) -> None:
    """Raises SceneError where the picture shows neither the object nor its shadow."""
    if bool((made.coverage > 0).any()) or bool((made.ratio < 1 - LEAST_CHANGE).any()):
        return
    corners = triangles.reshape(-1, 3)
    middle = (corners.amin(dim=0) + corners.amax(dim=0)) / 2
    size = (corners.amax(dim=0) - corners.amin(dim=0)).max().item()
    place = ", ".join(f"{value:.4g}" for value in torch.where(middle.abs() < ROUNDING * size, 0.0, middle).tolist())
    raise SceneError(
        f"the picture shows neither the object nor its shadow: it stands around ({place}), {size:.4g} large; "
        "check --position, --scale and --pose, and whether something hides it"
    )


def write_composite(path: Path, made: Insertion, photo: Photo, storage: Storage) -> float | None:
    """Writes the finished picture; pixels that did not change are stored as they were."""
    untouched = Untouched(photo.pixels, made.changed) if photo.bits is not None else None
    return write_picture(path, made.composite, storage, {"values": "linear, as the photograph"}, untouched)


def write_straight(path: Path, made: Insertion, photo: Photo, storage: Storage) -> float | None:
    """Writes object and shadow with straight alpha."""
    return write_picture(path, made.layer.straight, storage, {"values": "linear", "alpha": "straight"})


def write_premultiplied(path: Path, made: Insertion, photo: Photo, storage: Storage) -> float | None:
    """Writes object and shadow, premultiplied."""
    write_picture(path, made.layer.premultiplied, storage, {"values": "linear", "alpha": "premultiplied"})
    return None


def said(made: Insertion) -> str:
    """Returns what the picture holds."""
    shadow = ((made.ratio < 1 - DARKENED).any(dim=0) & (made.coverage < 1)).double().mean().item()
    return f"the object covers {made.coverage.mean().item():.1%} of the picture, its shadow falls on {shadow:.1%}"


def undetermined(path: Path, light: EnvironmentMap) -> list[str]:
    """Returns what is to be said of light on the object that the photograph does not determine, if that is much.

    Surfaces that face all ways receive light in proportion to its solid angle, the plane by the cosine as well: what
    comes from near the horizon lights an object, and hardly the plane that it was recovered from.
    """
    beside = observability_beside(path.parent)
    if beside is None:
        return []
    share = doubtful_share(light, read_observability(beside))
    if not share > DOUBTFUL:
        return []
    return [
        f"determined: {share:.0%} of the light that reaches upright surfaces comes from where the photograph tells "
        f"little of its structure ({beside.name}); the object's shading may be off there, its shadow hardly"
    ]


def doubtful_share(light: EnvironmentMap, observability: Float[Tensor, "height width"]) -> float:
    """Returns the share of the power from above the plane that comes from where R_ii is below `DETERMINED`."""
    height = observability.shape[0]
    directions = latlong.pixel_directions(height).reshape(-1, 3)
    power = luminance(radiance_at(light, directions).double().clamp(min=0))
    power = power * latlong.row_solid_angles(height).repeat_interleave(2 * height) * (directions[:, 2] > 0)
    total = float(power.sum())
    return float(power[observability.reshape(-1) < DETERMINED].sum()) / total if total > 0 else 0.0


def doubts(made: Insertion, photo: LinearPhoto, rendering: Rendering) -> list[str]:
    """Returns what a user should know, one line each."""
    lines = []
    factors = ", ".join(f"{value:.3g}" for value in made.brightness.tolist())
    if bool(made.brightness.isnan().any()):
        lines.append("brightness: the photograph shows no lit plane to compare the light with")
    elif rendering.fit_brightness:
        lines.append(f"brightness: the light was scaled by {factors} (red, green, blue) to fit the plane")
    elif bool(((made.brightness - 1).abs() > OFF).any()):
        lines.append(
            f"brightness: the plane is {factors} times as bright as this light makes it; is it the light of this "
            "photograph? --fit-brightness scales it"
        )
    if photo.saturated is not None:
        lost = int((photo.saturated & (made.ratio < 1 - DARKENED).any(dim=0) & (made.coverage < 1)).sum())
        if lost > 0:
            lines.append(f"saturated: {lost} pixels in the shadow are white in the photograph; they come out too dark")
    return lines
