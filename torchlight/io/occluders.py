"""The `occluders` of a scene file: meshes and primitives, placed, and checked to cast a shadow of their own."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import TorchlightError, TorchlightWarning
from torchlight.geometry import primitives
from torchlight.geometry.transforms import apply_matrix, transform
from torchlight.io import fields
from torchlight.io.fields import Field
from torchlight.io.meshes import read_mesh

MAX_OCCLUDERS = 1_000
_PLACEMENT_KEYS = ("scale", "rotation_degrees", "translation")
_LARGEST = 1e70  # coordinate: the squares of areas are still numbers
# relative to an occluder's own size: below the first, an extent is rounding; above the second, a dip below the plane
# is more than the float32 of a mesh that was meant to rest on it
_ROUNDING = 1e-9
_SINKING = 1e-5


@dataclass(frozen=True, eq=False)
class _Placed:
    """An occluder in the world, and the corners of its bounding box.

    `convex` says that it is a closed solid whose faces all have the rest of it behind them.
    """

    field: Field
    triangles: Float[Tensor, "faces 3 3"]
    convex: bool
    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]

    @property
    def extent(self) -> float:
        """Diagonal of the bounding box."""
        return math.dist(self.low.tolist(), self.high.tolist())


def read_occluders(field: Field) -> Float[Tensor, "faces 3 3"]:
    """Returns all triangles in the world frame, float64.

    An occluder "changes nothing", and is refused, where that can be decided exactly: it has no area, no part of it
    lies above the plane, it repeats another one, or it lies within a primitive. An occluder hidden within a *mesh*,
    or by several others together, is not detected.

    Raises:
        SceneError: as above, a primitive with a length that is not positive, or a singular matrix.
        ConfigError: unknown keys or wrong types.
        FormatError: a mesh file that cannot be read.
    """
    entries = fields.items(field, "a list of occluders such as [{box: [100, 60, 120]}]")
    if not entries:
        field.fail("no occluder, so no shadow; add one such as {box: [100, 60, 120]}")
    if len(entries) > MAX_OCCLUDERS:
        field.fail(f"{len(entries)} occluders are more than {MAX_OCCLUDERS:,}; combine them in one mesh")
    placed = [_read(entry) for entry in entries]
    for occluder in placed:
        _check_position(occluder)
    _check_hidden(placed)
    return torch.cat([occluder.triangles for occluder in placed])


def _read(field: Field) -> _Placed:
    known = fields.mapping(field, (*_SHAPES, *_PLACEMENT_KEYS, "matrix"))
    shapes = [name for name in _SHAPES if name in known]
    if len(shapes) != 1:
        found = "none" if not shapes else " and ".join(shapes)
        field.wrong_type(f"exactly one of {', '.join(_SHAPES)} (found {found})")
    shape = known[shapes[0]]
    return _measured(shape, _place(_SHAPES[shapes[0]](shape), known), convex=shapes[0] != "mesh")


def _mesh(field: Field) -> Float[Tensor, "faces 3 3"]:
    try:
        return read_mesh(field.file.parent / fields.text(field))
    except TorchlightError as error:
        raise type(error)(field.describe(str(error))) from error


def _box(field: Field) -> Float[Tensor, "faces 3 3"]:
    size = fields.numbers(field, 3)
    if min(size) <= 0:
        field.fail(f"expected three extents above 0, got {fields.shown(field.value)}")
    return primitives.box((size[0], size[1], size[2]))


def _cylinder(field: Field) -> Float[Tensor, "faces 3 3"]:
    return primitives.cylinder(*_radius_and_height(field))


def _cone(field: Field) -> Float[Tensor, "faces 3 3"]:
    return primitives.cone(*_radius_and_height(field))


def _sphere(field: Field) -> Float[Tensor, "faces 3 3"]:
    known = fields.mapping(field, ("radius",))
    return primitives.sphere(fields.positive(fields.required(known, "radius", field, "radius: 10")))


_SHAPES: dict[str, Callable[[Field], Tensor]] = {
    "mesh": _mesh,
    "box": _box,
    "cylinder": _cylinder,
    "cone": _cone,
    "sphere": _sphere,
}


def _radius_and_height(field: Field) -> tuple[float, float]:
    known = fields.mapping(field, ("radius", "height"))
    radius = fields.positive(fields.required(known, "radius", field, "radius: 10"))
    return radius, fields.positive(fields.required(known, "height", field, "height: 30"))


def _place(triangles: Float[Tensor, "faces 3 3"], known: dict[str, Field]) -> Float[Tensor, "faces 3 3"]:
    if "matrix" in known:
        return _place_by_matrix(triangles, known)
    scale = fields.positive(known["scale"]) if "scale" in known else 1.0
    rotation = fields.numbers(known["rotation_degrees"], 3) if "rotation_degrees" in known else (0.0, 0.0, 0.0)
    translation = fields.numbers(known["translation"], 3) if "translation" in known else (0.0, 0.0, 0.0)
    return transform(
        triangles, scale, (rotation[0], rotation[1], rotation[2]), (translation[0], translation[1], translation[2])
    )


def _place_by_matrix(triangles: Float[Tensor, "faces 3 3"], known: dict[str, Field]) -> Float[Tensor, "faces 3 3"]:
    field = known["matrix"]
    others = [name for name in _PLACEMENT_KEYS if name in known]
    if others:
        field.wrong_type(f"either matrix or {', '.join(_PLACEMENT_KEYS)}, not both (found {', '.join(others)})")
    try:
        return apply_matrix(triangles, fields.matrix(field, 4, 4))
    except TorchlightError as error:
        if str(error).startswith(str(field.file)):
            raise
        field.fail(str(error).removeprefix("matrix: "))


def _measured(field: Field, triangles: Float[Tensor, "faces 3 3"], *, convex: bool) -> _Placed:
    """Returns the occluder with its bounds; raises SceneError if it has no area."""
    if not bool((triangles.abs() < _LARGEST).all()):
        field.fail("too large once placed: its coordinates or areas overflow; use a smaller scale")
    corners = triangles.reshape(-1, 3)
    placed = _Placed(field, triangles, convex, corners.amin(dim=0), corners.amax(dim=0))
    area = torch.linalg.vector_norm(_cross_products(triangles), dim=-1).sum().item() / 2
    if area <= (_ROUNDING * placed.extent) ** 2:
        field.fail("has no area, so it casts no shadow; check the mesh and its scale")
    return placed


def _check_position(occluder: _Placed) -> None:
    lowest, highest = occluder.low[2].item(), occluder.high[2].item()
    if highest <= _ROUNDING * occluder.extent:
        occluder.field.fail(
            f"lies wholly on or below the plane (its z ends at {highest:g}), so it casts no shadow; "
            "raise it with translation: [x, y, z] or turn its up axis to +z with rotation_degrees"
        )
    if lowest < -_SINKING * occluder.extent:
        message = f"lies partly below the plane (down to z = {lowest:g}); only the part above casts a shadow"
        warnings.warn(occluder.field.describe(message), TorchlightWarning, stacklevel=4)


def _check_hidden(placed: list[_Placed]) -> None:
    """Raises SceneError for an occluder within another one's faces; only overlapping bounds are looked at closely."""
    lows, highs = torch.stack([other.low for other in placed]), torch.stack([other.high for other in placed])
    slack = _ROUNDING * torch.linalg.vector_norm(highs - lows, dim=1, keepdim=True)
    for index, occluder in enumerate(placed):
        around = ((occluder.low >= lows - slack) & (occluder.high <= highs + slack)).all(dim=1)
        around[index] = False
        for other in (placed[position] for position in around.nonzero().flatten().tolist()):
            if _repeats(occluder, other) or (other.convex and _inside(occluder, other)):
                message = f"changes nothing: it lies within {other.field.key}; remove it or move it with translation"
                occluder.field.fail(message)


def _repeats(occluder: _Placed, other: _Placed) -> bool:
    return occluder.triangles.shape == other.triangles.shape and torch.equal(occluder.triangles, other.triangles)


def _inside(occluder: _Placed, solid: _Placed) -> bool:
    """Returns whether every corner lies behind, or on, every face of a convex solid with outward faces."""
    points = occluder.triangles.reshape(-1, 3)
    normals = torch.nn.functional.normalize(_cross_products(solid.triangles), dim=-1)
    offsets = (normals * solid.triangles[:, 0]).sum(dim=-1)
    chunk = max(1, 4_000_000 // len(points))
    limit = _ROUNDING * solid.extent
    pieces = zip(normals.split(chunk), offsets.split(chunk), strict=True)
    return all(bool((points @ normal.T <= offset + limit).all()) for normal, offset in pieces)


def _cross_products(triangles: Float[Tensor, "faces 3 3"]) -> Float[Tensor, "faces 3"]:
    """Returns each face's outward normal times twice its area."""
    edges = triangles[:, 1:] - triangles[:, :1]
    return torch.linalg.cross(edges[:, 0], edges[:, 1])
