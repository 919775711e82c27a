"""What every cell of a view shows: the plane, an object that is there, the new object, or nothing known."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchlight.geometry.receiver import Receiver
from torchlight.insertion.sight import Sight, cell_rays
from torchlight.insertion.stage import Stage

NOTHING, PLANE, OLD, NEW = 0, 1, 2, 3
FARTHEST = 1e3  # of the unit frame: the plane is not followed to the horizon
SLACK = 1e-5  # of the unit frame: an object that rests on the plane is in front of it


@dataclass(frozen=True, eq=False)
class Seen:
    """Where the rays of each cell end.

    Attributes:
        kind: NOTHING, PLANE, OLD or NEW, of each ray.
        points: where it ends.
        facing: unit normal of the face there, towards the viewer.
        normals: unit normal for shading, on the same side.
        toward: unit vector back to the viewer.
    """

    kind: UInt8[Tensor, "cells sub"]
    points: Float[Tensor, "cells sub 3"]
    facing: Float[Tensor, "cells sub 3"]
    normals: Float[Tensor, "cells sub 3"]
    toward: Float[Tensor, "cells sub 3"]

    def only(self, rows: Bool[Tensor, " cells"], kind: int) -> Seen:
        """Returns some cells, each of which shows a kind, with every ray of another kind replaced by its first one."""
        shows = self.kind[rows] == kind
        first = shows.float().argmax(dim=1)
        sub = torch.where(shows, torch.arange(shows.shape[1]), first[:, None])
        cell = rows.nonzero()
        values = (getattr(self, name)[cell, sub] for name in ("kind", "points", "facing", "normals", "toward"))
        return Seen(*values)


def look(stage: Stage, sight: Sight, index: Int[Tensor, " cells"], only_receiver: bool = False) -> Seen:
    """Returns what some cells of a view show.

    Args:
        stage: the scene with the new object.
        sight: the view.
        index: numbers of the cells.
        only_receiver: whether the plane ends where the receiver does.
    """
    origins, directions = cell_rays(sight, index)
    lead = directions.shape[:2]
    origins, directions = origins.reshape(-1, 3), directions.reshape(-1, 3)
    hits = stage.eye.seen(origins, directions)
    scale = stage.eye.frame.scale
    down = -origins[:, 2] / torch.where(directions[:, 2] == 0, torch.ones_like(directions[:, 2]), directions[:, 2])
    down = torch.where((directions[:, 2] != 0) & (down > 0) & (down * scale < FARTHEST), down, torch.inf)
    on_object = hits.distance <= down + SLACK / scale
    on_object &= hits.face >= 0
    depth = torch.where(on_object, hits.distance, down)
    reached = torch.where(depth.isfinite(), depth, torch.zeros_like(depth))
    points = origins + reached[:, None] * directions
    kind = torch.where(on_object, torch.where(hits.face < stage.olds, OLD, NEW), PLANE)
    known = depth.isfinite()
    if only_receiver:
        known &= on_object | within(points, sight.receiver)
    kind = torch.where(known, kind, NOTHING)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(points)
    facing, normals = _normals(stage, hits.face.clamp(min=0), hits.corners, -directions)
    facing, normals = (torch.where(on_object[:, None], n, up) for n in (facing, normals))
    parts = (kind.to(torch.uint8), points, facing, normals, -directions)
    return Seen(*(part.reshape(*lead, *part.shape[1:]) for part in parts))


def within(points: Float[Tensor, "rays 3"], receiver: Receiver) -> Bool[Tensor, " rays"]:
    """Returns whether points of the plane lie on the receiver."""
    center, size = (torch.tensor(pair, dtype=points.dtype) for pair in (receiver.center, receiver.size))
    return ((points[:, :2] - center).abs() <= size / 2).all(dim=-1)


def _normals(
    stage: Stage,
    face: Int[Tensor, " rays"],
    corners: Float[Tensor, "rays 3"],
    toward: Float[Tensor, "rays 3"],
) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
    """Returns the face's normal and the one for shading, both on the viewer's side."""
    if len(stage.facing) == 0:
        return torch.zeros_like(toward), torch.zeros_like(toward)
    facing = stage.facing[face]
    side = torch.where((facing * toward).sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    smooth = torch.nn.functional.normalize((corners[..., None] * stage.normals[face]).sum(dim=1), dim=-1)
    return side * facing, side * smooth
