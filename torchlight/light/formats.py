"""Other people's pictures of the whole sphere, turned into torchlight's lat-long and back.

Lat-long images differ only by where the seam is; none is mirrored. Conventions with Y up are compared after their
scene is turned to Z up by (x, y, z) -> (x, -z, y), which is what glTF, USD and Debevec's probes ask for:

    torchlight, blender      Z up, centre +X
    threejs                  Y up, centre +X: the same picture
    openexr, usd, mitsuba    Y up, centre +Z, left quarter +X: torchlight's picture rolled left by a quarter
    skylibs                  Y up, centre -Z, right quarter +X: torchlight's picture rolled right by a quarter

Mitsuba puts row r at theta = pi r / (H - 1) where the others have pi (r + 1/2) / H; its maps are taken as OpenEXR's,
which moves light by at most half a pixel.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.light import cubemap, latlong
from torchlight.light.directions import from_angles
from torchlight.light.overlap import cubemap_to_latlong

CONVENTIONS = ("torchlight", "blender", "threejs", "openexr", "usd", "mitsuba", "skylibs")
_QUARTERS_LEFT = {"openexr": 1, "usd": 1, "mitsuba": 1, "skylibs": -1}  # of torchlight's picture, to get theirs
_SUBSAMPLES = 3
_ROWS_AT_ONCE = 16

# Debevec's vertical cross, in the probe's own frame (Y up, looking along -Z), for the faces +x -x +y -y +z -z:
# place (row, column) in the 4 x 3 grid, then the directions to the right of and up in the stored picture.
_CROSS_PLACES = ((1, 2), (1, 0), (0, 1), (2, 1), (3, 1), (1, 1))
_CROSS_RIGHT = ((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 0, 0), (1, 0, 0), (1, 0, 0))
_CROSS_UP = ((0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0), (0, 1, 0))


def kind_of(height: int, width: int) -> str:
    """Returns "latlong" (2:1), "cross" (3:4, vertical) or "angular" (1:1), from the shape of a picture alone.

    Raises:
        FormatError: any other shape.
    """
    if width == 2 * height:
        return "latlong"
    if 4 * width == 3 * height and width % 3 == 0:
        return "cross"
    if width == height:
        return "angular"
    raise FormatError(
        f"environment map: {width} x {height} pixels is no lat-long (2:1), vertical cube cross (3:4) "
        "or angular map (1:1); crop or resample it"
    )


def from_latlong(image: Float[Tensor, "*batch height width"], convention: str) -> Float[Tensor, "*batch height width"]:
    """Returns a lat-long picture of a named convention in torchlight's convention; exact, no resampling."""
    return _roll_left(image, -_quarters(convention))


def to_latlong(image: Float[Tensor, "*batch height width"], convention: str) -> Float[Tensor, "*batch height width"]:
    """Returns a picture in torchlight's convention in a named one; exact, no resampling."""
    return _roll_left(image, _quarters(convention))


def to_z_up(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Returns Y-up directions in torchlight's world: (x, y, z) -> (x, -z, y)."""
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([x, -z, y], dim=-1)


def to_y_up(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Returns torchlight's directions in a Y-up world: (x, y, z) -> (x, z, -y)."""
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([x, z, -y], dim=-1)


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


# --- vertical cube cross -------------------------------------------------------------------------------------------


def cross_to_cubemap(
    image: Float[Tensor, "*batch rows columns"],
) -> Float[Tensor, "*batch 6 resolution resolution"]:
    """Returns the six faces, in torchlight's frame, of a vertical cube cross of 4 F x 3 F pixels; exact.

    The cross unfolds the cube seen from inside, Y up: +Y above -X, -Z, +X, then -Y, then +Z upside down. The probe's
    forward -Z becomes +Y of the world, its right +X stays. Pixels outside the cross (captions) are not light.
    Checked by continuity across all edges, and against the angular map of the same place, on Debevec's probes.

    References:
        Debevec, Light Probe Image Gallery (1999).
    """
    rows, columns = image.shape[-2:]
    if kind_of(rows, columns) != "cross":
        raise ShapeError(f"cube cross: expected 3 F x 4 F pixels, got {columns} x {rows}")
    resolution = columns // 3
    directions = to_y_up(cubemap.texel_directions(resolution))
    # Faces are named alike in both frames, up to the turn: take the largest component in the probe's own.
    axes = torch.stack([directions, -directions], dim=-1).flatten(start_dim=-2)
    length, face = axes.max(dim=-1)
    u = (directions * _vectors(_CROSS_RIGHT)[face]).sum(dim=-1) / length
    v = (directions * _vectors(_CROSS_UP)[face]).sum(dim=-1) / length
    place = torch.tensor(_CROSS_PLACES, device=face.device)[face] * resolution
    row = place[:, 0] + ((1 - v) * (resolution / 2)).long()
    column = place[:, 1] + ((1 + u) * (resolution / 2)).long()
    values = image[..., row.to(image.device), column.to(image.device)]
    return values.unflatten(-1, (6, resolution, resolution))


def cross_to_latlong(image: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch height width"]:
    """Returns the lat-long of a vertical cube cross with faces of F x F pixels: 2 F rows, area-averaged."""
    faces = cross_to_cubemap(image)
    return cubemap_to_latlong(faces, 2 * faces.shape[-1])


def _vectors(rows: tuple[tuple[int, int, int], ...]) -> Float[Tensor, "rows 3"]:
    return torch.tensor(rows, dtype=torch.float64)


# --- angular map ---------------------------------------------------------------------------------------------------


def angular_coordinates(
    directions: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Returns (u to the right, v up) in the unit disc of an angular map, of directions in torchlight's world.

    (u, v) = (Dx, Dy) acos(-Dz) / (pi sqrt(Dx^2 + Dy^2)) in the probe's frame (Y up): the centre looks along -Z, which
    is +Y of the world, and the rim behind. Of the two published formulas the one with +Dz would mirror the world;
    the cube cross of the same place and the sides of the church round Galileo's tomb agree with -Dz.

    References:
        Debevec, Light Probe Image Gallery (1999).
    """
    x, y, z = to_y_up(directions).unbind(dim=-1)
    sideways = torch.hypot(x, y)
    radius = torch.atan2(sideways, -z) / math.pi
    # On the axis itself the picture's centre or any point of the rim will do.
    scale = radius / torch.where(sideways > 0, sideways, 1)
    return x * scale, y * scale


def angular_solid_angles(
    size: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{size} {size}"]:
    """Returns the solid angle of each pixel of an angular map: (2 pi / D)^2 sin(a) / a at a = pi r; 0 outside."""
    position = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    radius = torch.hypot(position[:, None], position)
    angles = (2 * math.pi / size) ** 2 * torch.sinc(radius)
    return torch.where(radius <= 1, angles, 0).to(dtype=dtype, device=device)


def angular_to_latlong(image: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch height width"]:
    """Returns the lat-long of a D x D angular map: D rows (rounded up to even), area-averaged from bilinear samples.

    Pixels outside the disc (captions) are not light and take no part in the interpolation.
    """
    size = image.shape[-1]
    if image.shape[-2] != size:
        raise ShapeError(f"angular map: expected a square picture, got {size} x {image.shape[-2]}")
    height = size + size % 2
    inside = (angular_solid_angles(size, device=image.device) > 0).to(image.dtype)
    planes = torch.cat([(image * inside).reshape(-1, size, size), inside[None]])[None]
    rows = [_angular_rows(planes, rows, height) for rows in torch.arange(height).split(_ROWS_AT_ONCE)]
    return torch.cat(rows, dim=-2).reshape(*image.shape[:-2], height, 2 * height)


def _angular_rows(
    planes: Float[Tensor, "1 planes size size"], rows: Int[Tensor, " rows"], height: int
) -> Float[Tensor, "images rows width"]:
    """Returns some lat-long rows, averaged over sub-directions that each stand for the same solid angle."""
    steps = (torch.arange(_SUBSAMPLES, dtype=torch.float64) + 0.5) / _SUBSAMPLES
    edges = torch.cos(latlong.row_boundaries(height))
    top, bottom = edges[rows][:, None], edges[rows + 1][:, None]
    theta = torch.acos(top + (bottom - top) * steps).reshape(-1, 1)
    columns = (torch.arange(2 * height, dtype=torch.float64)[:, None] + steps).reshape(-1)
    u, v = angular_coordinates(from_angles(theta, math.pi * (1 - columns / height)))
    grid = torch.stack([u, -v], dim=-1)[None].to(planes)
    samples = torch.nn.functional.grid_sample(planes, grid, mode="bilinear", align_corners=False)[0]
    values = (samples[:-1] / samples[-1:]).unflatten(-1, (2 * height, _SUBSAMPLES))
    return values.unflatten(1, (len(rows), _SUBSAMPLES)).mean(dim=(2, 4))
