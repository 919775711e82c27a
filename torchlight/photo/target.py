"""The printed sheet: where its markers lie, where the object stands, and how far the object's shadow reaches.

World frame of the sheet: origin in the middle of its clean inside, x to the right and y up the page as it is read, z
up towards the light; lengths in millimetres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import CalibrationError, ConfigError

PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "letter": (215.9, 279.4)}
MARKER_SIZES = {"A4": 20.0, "A3": 28.0, "letter": 20.0}
DICTIONARY = "DICT_4X4_50"
RULER_LENGTH = 100.0
RULER_TOLERANCE = 0.005  # an honest reading of 100 mm is good to half a millimetre
MARGIN = 8.0  # printers leave about 5 mm white
STRIP = 10.0  # beside the margin along the lower edge: the ruler and the orientation mark
CIRCLE_SEGMENTS = 128
SHAPES = {"box": 3, "cylinder": 2, "cone": 2}


@dataclass(frozen=True)
class Sheet:
    """Markers around a clean white inside.

    Attributes:
        paper: width and height of the page.
        dictionary: OpenCV's name of the ArUco dictionary; marker i of the sheet has the id i.
        marker_size: length of a marker's black square.
        markers: x and y of each marker's centre.
        inside: width and height of the clean rectangle around the origin.
        origin: the world's origin, counted from the page's lower left corner.
    """

    paper: tuple[float, float]
    dictionary: str
    marker_size: float
    markers: tuple[tuple[float, float], ...]
    inside: tuple[float, float]
    origin: tuple[float, float]


@dataclass(frozen=True)
class Prop:
    """The object that is to stand on the sheet.

    Attributes:
        shape: "box", "cylinder" or "cone".
        size: x, y and z extents of a box; radius and height of a cylinder or a cone.
        position: x and y of its middle.
        turn_degrees: counter-clockwise, seen from above.
    """

    shape: str
    size: tuple[float, ...]
    position: tuple[float, float] = (0.0, 0.0)
    turn_degrees: float = 0.0

    def __post_init__(self) -> None:
        wanted = SHAPES.get(self.shape)
        if wanted is None or len(self.size) != wanted or not all(0 < value < math.inf for value in self.size):
            got = f"{self.shape}:{','.join(f'{value:g}' for value in self.size)}"
            raise ConfigError(f"object: expected box:x,y,z, cylinder:radius,height or cone:radius,height, got {got}")

    @property
    def height(self) -> float:
        """Its highest z."""
        return self.size[-1]


DEFAULT_PROP = Prop("box", (30.0, 20.0, 35.0), (0.0, 0.0), 30.0)


@dataclass(frozen=True)
class Reach:
    """How low a light may stand, in degrees above the plane, whatever its azimuth.

    Attributes:
        inside_degrees: above it, the shadow stays within the clean inside.
        sheet_degrees: above it, the shadow stays on the page.
        markers: ids on which the shadow may fall while it stays on the page.
    """

    inside_degrees: float
    sheet_degrees: float
    markers: tuple[int, ...]


def make_sheet(paper: str) -> Sheet:
    """Returns the sheet for a paper in `PAPERS`: a ring of markers along all four sides, at least a third apart."""
    if paper not in PAPERS:
        raise ConfigError(f"paper: expected {', '.join(PAPERS)}, got {paper}")
    width, height = PAPERS[paper]
    size = MARKER_SIZES[paper]
    ring_width, ring_height = width - 2 * MARGIN, height - 2 * MARGIN - STRIP
    across, up = _along(ring_width, size), _along(ring_height, size)
    right, top = across[-1], up[-1]
    bottom_row = [(x, -top) for x in across]
    right_column = [(right, y) for y in up[1:-1]]
    top_row = [(x, top) for x in reversed(across)]
    left_column = [(-right, y) for y in reversed(up[1:-1])]
    rim = 2 * size + size / 2  # both markers, and a quiet zone of more than a cell beside each
    return Sheet(
        paper=(width, height),
        dictionary=DICTIONARY,
        marker_size=size,
        markers=(*bottom_row, *right_column, *top_row, *left_column),
        inside=(round(ring_width - rim, 4), round(ring_height - rim, 4)),
        origin=(width / 2, MARGIN + STRIP + ring_height / 2),
    )


def _along(length: float, size: float) -> list[float]:
    count = int((length - size) / (size * 4 / 3)) + 1
    span = length - size
    return [round(-span / 2 + span * index / (count - 1), 4) for index in range(count)]


def marker_corners(sheet: Sheet) -> Float[Tensor, "markers 4 3"]:
    """Returns the corners of every marker in the world, in ArUco's order: upper left, then clockwise from above."""
    centers = torch.tensor(sheet.markers, dtype=torch.float64)
    square = torch.tensor([[-1, 1], [1, 1], [1, -1], [-1, -1]], dtype=torch.float64) * (sheet.marker_size / 2)
    corners = centers[:, None] + square
    return torch.cat([corners, torch.zeros_like(corners[..., :1])], dim=-1)


def footprint(prop: Prop) -> Float[Tensor, "corners 2"]:
    """Returns the outline on which the object stands, counter-clockwise; a circle has 128 corners."""
    if prop.shape == "box":
        x, y = prop.size[0] / 2, prop.size[1] / 2
        outline = torch.tensor([[-x, -y], [x, -y], [x, y], [-x, y]], dtype=torch.float64)
    else:
        angle = torch.arange(CIRCLE_SEGMENTS, dtype=torch.float64) * (2 * math.pi / CIRCLE_SEGMENTS)
        outline = prop.size[0] * torch.stack([angle.cos(), angle.sin()], dim=-1)
    cosine, sine = math.cos(math.radians(prop.turn_degrees)), math.sin(math.radians(prop.turn_degrees))
    turn = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
    return outline @ turn.T + torch.tensor(prop.position, dtype=torch.float64)


def top(prop: Prop) -> Float[Tensor, "corners 2"]:
    """Returns the outline of the object's highest part, seen from above: a cone's is one point."""
    if prop.shape == "cone":
        return torch.tensor([prop.position], dtype=torch.float64)
    return footprint(prop)


def shadow_reach(sheet: Sheet, prop: Prop) -> Reach:
    """Returns how low a light may stand before the object's shadow leaves the inside, or the page.

    A point at height z above p throws its shadow on the circle of radius z cot(elevation) around p as the light goes
    round. A rectangle holds that disc while the radius is at most p's distance d to its nearest side, so the limit is
    atan(z / min d) over the corners of the top. A marker may be met where its distance to the top is below the radius.

    Raises:
        ConfigError: the object does not stand within the clean inside.
    """
    inside = _distance_to_sides(footprint(prop), (0.0, 0.0), sheet.inside)
    if inside <= 0:
        width, height = sheet.inside
        raise ConfigError(
            f"object: it must stand within the clean white, {width:g} x {height:g} mm around the origin, "
            f"and lies {-inside:.1f} mm beyond; move it with --pose or choose a larger paper"
        )
    middle = (sheet.paper[0] / 2 - sheet.origin[0], sheet.paper[1] / 2 - sheet.origin[1])
    clear, page = (
        _distance_to_sides(top(prop), (0.0, 0.0), sheet.inside),
        _distance_to_sides(top(prop), middle, sheet.paper),
    )
    squares = marker_corners(sheet)[..., :2]
    met = [index for index, square in enumerate(squares) if _convex_distance(square, top(prop)) < page]
    return Reach(
        inside_degrees=math.degrees(math.atan2(prop.height, clear)),
        sheet_degrees=math.degrees(math.atan2(prop.height, page)),
        markers=tuple(met),
    )


def check_ruler(printed: float, measured: float) -> None:
    """Raises CalibrationError where a printed length does not measure what it should, within half a percent."""
    scale = measured / printed
    if abs(scale - 1) > RULER_TOLERANCE:
        raise CalibrationError(
            f"ruler: it should measure {printed:g} mm but measures {measured:g} mm, so the print is at {scale:.1%} and "
            "every length would be wrong by as much; print at 100 % (actual size), or state the true square size"
        )


def _distance_to_sides(
    points: Float[Tensor, "points 2"], middle: tuple[float, float], size: tuple[float, float]
) -> float:
    """Returns the least distance from any point to the sides of a rectangle; negative outside."""
    offset = (points - torch.tensor(middle, dtype=points.dtype)).abs()
    return (torch.tensor(size, dtype=points.dtype) / 2 - offset).min().item()


def _convex_distance(one: Float[Tensor, "m 2"], other: Float[Tensor, "n 2"]) -> float:
    """Returns the distance of two disjoint convex outlines: a corner of one of them is always among the nearest."""
    return min(_corners_to_edges(one, other), _corners_to_edges(other, one))


def _corners_to_edges(corners: Float[Tensor, "m 2"], outline: Float[Tensor, "n 2"]) -> float:
    start, edge = outline, outline.roll(-1, 0) - outline
    offset = corners[:, None] - start
    length = edge.square().sum(-1).clamp(min=1e-30)
    along = ((offset * edge).sum(-1) / length).clamp(0, 1)
    return torch.linalg.vector_norm(offset - along[..., None] * edge, dim=-1).min().item()
