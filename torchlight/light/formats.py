"""Other people's pictures of the whole sphere, by name, and what they hold in torchlight's own frame.

Lat-long images (also called equirectangular) differ only by where the seam is; none is mirrored. Conventions with Y up
are compared after their scene is turned to Z up by (x, y, z) -> (x, -z, y), which is what glTF, USD and Debevec's
probes ask for:

    torchlight, blender      Z up, centre +X
    threejs                  Y up, centre +X: the same picture
    openexr, usd, mitsuba    Y up, centre +Z, left quarter +X: torchlight's picture rolled left by a quarter
    skylibs                  Y up, centre -Z, right quarter +X: torchlight's picture rolled right by a quarter

Mitsuba puts row r at theta = pi r / (H - 1) where the others have pi (r + 1/2) / H; its maps are taken as OpenEXR's,
which moves light by at most half a pixel. Cube maps are those of `layouts`, and "angular" is Debevec's angular map.
"""

from __future__ import annotations

import difflib

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.light import latlong
from torchlight.light.grids import AngularGrid, CubeGrid, Grid, LatlongGrid
from torchlight.light.layouts import LAYOUTS, face_edge, faces_to_picture, picture_to_faces
from torchlight.light.resampling import resample

CONVENTIONS = ("torchlight", "blender", "threejs", "openexr", "usd", "mitsuba", "skylibs")
KINDS = (*CONVENTIONS, *LAYOUTS, "angular")
_QUARTERS_LEFT = {"openexr": 1, "usd": 1, "mitsuba": 1, "skylibs": -1}  # of torchlight's picture, to get theirs


def kind_of(height: int, width: int) -> str:
    """Returns "latlong" (2:1), "cross" (3:4, vertical), "strip" (6:1) or "angular" (1:1), from a picture's shape alone.

    Raises:
        FormatError: any other shape.
    """
    if width == 2 * height:
        return "latlong"
    if 4 * width == 3 * height and width % 3 == 0:
        return "cross"
    if width == 6 * height:
        return "strip"
    if width == height:
        return "angular"
    if 3 * width == 4 * height and height % 3 == 0:
        raise FormatError(
            f"environment map: {width} x {height} pixels are a photograph's shape; if it is a horizontal cross, "
            "name it horizontal-cross, else crop or resample it"
        )
    raise FormatError(
        f"environment map: {width} x {height} pixels is no lat-long (2:1), vertical cube cross (3:4), cube strip (6:1) "
        "or angular map (1:1); crop or resample it"
    )


def check_kind(name: str) -> None:
    """Raises ConfigError unless the name is one of `KINDS`."""
    if name not in KINDS:
        near = difflib.get_close_matches(name, KINDS, n=1)
        advice = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(f"convention: unknown name {name!r}; {advice}choose one of {', '.join(KINDS)}")


def is_latlong(name: str) -> bool:
    """Returns whether a kind is a lat-long."""
    return name in CONVENTIONS


# --- any picture ---------------------------------------------------------------------------------------------------


def grid_for(name: str, size: int) -> Grid:
    """Returns the grid of a kind: `size` is a lat-long's height, a face's edge, or an angular map's diameter."""
    check_kind(name)
    if is_latlong(name):
        return LatlongGrid(size)
    return AngularGrid(size) if name == "angular" else CubeGrid(size)


def grid_as_fine(name: str, grid: Grid) -> Grid:
    """Returns the grid of a kind that keeps the detail of another grid: the same one where the kind allows."""
    check_kind(name)
    like = {LatlongGrid: is_latlong(name), AngularGrid: name == "angular", CubeGrid: name in LAYOUTS}
    if like[type(grid)]:
        return grid
    if is_latlong(name):
        return LatlongGrid(grid.rows)
    return AngularGrid(2 * grid.rows) if name == "angular" else CubeGrid(-(-grid.rows // 2))


def from_picture(image: Float[Tensor, "*batch rows columns"], name: str) -> tuple[Float[Tensor, "*batch pixels"], Grid]:
    """Returns the values of a picture of a kind on its grid, in torchlight's frame, and the grid; exact.

    Raises:
        ConfigError: an unknown kind.
        ShapeError: the picture has not the shape of its kind.
    """
    check_kind(name)
    rows, columns = image.shape[-2:]
    if is_latlong(name):
        return from_latlong(image, name).flatten(start_dim=-2), LatlongGrid(rows)
    if name == "angular":
        _check_square(rows, columns)
        return image.flatten(start_dim=-2), AngularGrid(rows)
    return picture_to_faces(image, name).flatten(start_dim=-3), CubeGrid(face_edge(name, rows, columns))


def to_picture(values: Float[Tensor, "*batch pixels"], grid: Grid, name: str) -> Float[Tensor, "*batch rows columns"]:
    """Returns the picture of a kind of values on a grid that is the kind's; exact. Captions are 0.

    Raises:
        ConfigError: an unknown kind.
        ShapeError: the grid is another kind's; resample first.
    """
    if grid_as_fine(name, grid) != grid:
        raise ShapeError(f"{name}: values on {grid} are no such picture; resample them to grid_as_fine({name!r}, grid)")
    image = values.unflatten(-1, grid.shape)
    if is_latlong(name):
        return to_latlong(image, name)
    if name == "angular":
        return image * (grid.solid_angles().reshape(grid.shape) > 0).to(image)
    return faces_to_picture(image, name)


# --- lat-longs -----------------------------------------------------------------------------------------------------


def from_latlong(image: Float[Tensor, "*batch height width"], convention: str) -> Float[Tensor, "*batch height width"]:
    """Returns a lat-long picture of a named convention in torchlight's convention; exact, no resampling."""
    return _roll_left(image, -_quarters(convention))


def to_latlong(image: Float[Tensor, "*batch height width"], convention: str) -> Float[Tensor, "*batch height width"]:
    """Returns a picture in torchlight's convention in a named one; exact, no resampling."""
    return _roll_left(image, _quarters(convention))


def _quarters(convention: str) -> int:
    if convention not in CONVENTIONS:
        raise ConfigError(f"convention: unknown name {convention!r}; choose one of {', '.join(CONVENTIONS)}")
    return _QUARTERS_LEFT.get(convention, 0)


def _roll_left(image: Float[Tensor, "*batch height width"], quarters: int) -> Float[Tensor, "*batch height width"]:
    height, width = image.shape[-2:]
    latlong.check_latlong(height, width)
    if quarters != 0 and width % 4 != 0:
        raise ShapeError(
            f"lat-long image: a quarter turn of {width} columns is not a whole number of pixels; "
            "resample it to a width that 4 divides"
        )
    return image.roll(-quarters * width // 4, dims=-1)


# --- the rest, as lat-longs ----------------------------------------------------------------------------------------


def cross_to_cubemap(
    image: Float[Tensor, "*batch rows columns"],
) -> Float[Tensor, "*batch 6 resolution resolution"]:
    """Returns the six faces, in torchlight's frame, of a vertical cube cross of 3 F x 4 F pixels; exact.

    Checked by continuity across all edges, and against the angular map of the same place, on Debevec's probes.
    """
    return picture_to_faces(image, "cross")


def cross_to_latlong(image: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch height width"]:
    """Returns the lat-long of a vertical cube cross with faces of F x F pixels: 2 F rows, area-averaged."""
    return picture_to_latlong(image, "cross")


def angular_to_latlong(image: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch height width"]:
    """Returns the lat-long of a D x D angular map: D rows (rounded up to even), area-averaged."""
    return picture_to_latlong(image, "angular")


def picture_to_latlong(image: Float[Tensor, "*batch rows columns"], name: str) -> Float[Tensor, "*batch height width"]:
    """Returns the lat-long, in torchlight's convention, of a picture of a kind; each pixel's flux is kept."""
    values, grid = from_picture(image, name)
    target = LatlongGrid(grid.rows)
    return resample(values, grid, target).unflatten(-1, target.shape)


def _check_square(rows: int, columns: int) -> None:
    if rows != columns or rows < 1:
        raise ShapeError(f"angular map: expected a square picture, got {columns} x {rows}")
