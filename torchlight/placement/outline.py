"""The outline of the occluders as a camera sees them: where in the photograph they end and the background begins.

An edge of a mesh can bound the picture of a solid only where one of its two faces looks towards the camera and the
other away, or where it has one face alone (`geometry.contours`). Points along such edges belong to the outline where
the camera meets an occluder a little inside of them and none a little outside.

A point s of an occluder moves with the pose q = (x, y, turn about the vertical through m) by

    ds/dx = (1, 0, 0),    ds/dy = (0, 1, 0),    ds/dturn = (0, 0, 1) x (s - m),

and its place along the outline's normal n by n . dp/ds ds/dq, p being the pixel. Where the surface is round, other
points become the outline when it moves; they slide along the surface's picture, so that the normal's part is the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.camera import Camera, pixel_directions, project
from torchlight.geometry.contours import Contours
from torchlight.geometry.footprints import FOLD_COSINE
from torchlight.geometry.visibility import OcclusionTest
from torchlight.view import meets_occluder, plane_depth

SPACING = 2.0  # pixels between samples, at least
MOST_SAMPLES = 400  # about
PROBES = (1.5, 0.3)  # pixels to each side, where an occluder has to be and not to be; the near one tells corners


@dataclass(frozen=True, eq=False)
class Outline:
    """Samples of the outline.

    Attributes:
        points: in the world.
        pixels: where the photograph shows them.
        normals: of the outline in the photograph, outwards, unit length.
        framed: whether the photograph holds them.
    """

    points: Float[Tensor, "samples 3"]
    pixels: Float[Tensor, "samples 2"]
    normals: Float[Tensor, "samples 2"]
    framed: Bool[Tensor, " samples"]

    def __len__(self) -> int:
        return len(self.points)


def outline(contours: Contours, camera: Camera, test: OcclusionTest) -> Outline:
    """Returns the outline of occluders seen by a camera.

    Args:
        contours: the occluders' edges.
        camera: that sees them.
        test: the same occluders.
    """
    points, along = spaced(contours, camera)
    pixels, tangents = moved(camera, points, along)
    length = tangents.norm(dim=-1, keepdim=True)
    clear = pixels.isfinite().all(dim=-1) & (length[:, 0] > 1e-9) & unfolded(camera, points, pixels)
    points, pixels, tangents = points[clear], pixels[clear], (tangents / length)[clear]
    normals = torch.stack([tangents[:, 1], -tangents[:, 0]], dim=-1)
    outside, inside = (
        torch.stack([seen_occluder(test, camera, pixels + side * probe * normals) for probe in PROBES])
        for side in (1, -1)
    )
    edge = (outside != inside).all(dim=0) & (outside[0] == outside[1])
    normals = torch.where(outside[0][:, None], -normals, normals)
    limits = torch.tensor(camera.image_size, dtype=torch.float64) - 1
    framed = ((pixels >= 0) & (pixels <= limits)).all(dim=-1)
    return Outline(points[edge], pixels[edge], normals[edge], framed[edge])


def spaced(contours: Contours, camera: Camera) -> tuple[Float[Tensor, "samples 3"], Float[Tensor, "samples 3"]]:
    """Returns points on the edges that may be outline, evenly spaced in the photograph, and the edges' directions."""
    ends, normals, sides = (torch.from_numpy(part) for part in (contours.ends, contours.normals, contours.sides))
    towards = camera.position.double() - ends[:, :1]
    sheets = (sides * (normals * towards).sum(dim=-1).sign()).sum(dim=-1)
    ends = ends[sheets != 0]
    pixels = project(camera, ends)
    length = (pixels[:, 1] - pixels[:, 0]).norm(dim=-1).nan_to_num()
    spacing = max(SPACING, float(length.sum()) / MOST_SAMPLES)
    count = (length / spacing).round().clamp(min=(length > 0).double()).long()
    edge = torch.repeat_interleave(torch.arange(len(ends)), count)
    first = (count.cumsum(dim=0) - count)[edge]
    share = ((torch.arange(len(edge)) - first + 0.5) / count[edge])[:, None]
    along = ends[:, 1] - ends[:, 0]
    return ends[edge, 0] + share * along[edge], torch.nn.functional.normalize(along, dim=-1)[edge]


def unfolded(
    camera: Camera, points: Float[Tensor, "samples 3"], pixels: Float[Tensor, "samples 2"]
) -> Bool[Tensor, " samples"]:
    """Returns whether a pixel looks at its point: far outside the frame a distortion polynomial folds back into it."""
    towards = torch.nn.functional.normalize(points - camera.position.double(), dim=-1)
    return (pixel_directions(camera, pixels.nan_to_num()) * towards).sum(dim=-1) > FOLD_COSINE


def seen_occluder(test: OcclusionTest, camera: Camera, pixels: Float[Tensor, "samples 2"]) -> Bool[Tensor, " samples"]:
    """Returns whether pixels show an occluder."""
    directions = pixel_directions(camera, pixels)
    return meets_occluder(test, camera, directions, plane_depth(camera, directions))


def sensitivity(
    seen: Outline, camera: Camera, middle: Float[Tensor, "2"], unit: Float[Tensor, "3"]
) -> Float[Tensor, "samples 3"]:
    """Returns how far the outline moves outwards along its normals, in pixels, per unit of x, y and turn.

    Args:
        seen: the outline.
        camera: that sees it.
        middle: m, what turns go about.
        unit: of x, y and the turn (radians).
    """
    x = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand_as(seen.points)
    y = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand_as(seen.points)
    arm = seen.points[:, :2] - middle
    turn = torch.stack([-arm[:, 1], arm[:, 0], torch.zeros_like(arm[:, 0])], dim=-1)
    rates = [(seen.normals * moved(camera, seen.points, rate)[1]).sum(dim=-1) for rate in (x, y, turn)]
    return torch.stack(rates, dim=-1) * unit


def moved(
    camera: Camera, points: Float[Tensor, "samples 3"], rates: Float[Tensor, "samples 3"]
) -> tuple[Float[Tensor, "samples 2"], Float[Tensor, "samples 2"]]:
    """Returns the pixels of points, and how fast they move where the points move at some rates."""
    places = points.detach().clone().requires_grad_(True)
    pixels = project(camera, places)
    rows = [torch.autograd.grad(pixels[:, axis].nansum(), places, retain_graph=axis == 0)[0] for axis in (0, 1)]
    return pixels.detach(), torch.stack([(row * rates).sum(dim=-1) for row in rows], dim=-1)
