"""What stands on the plane, old and new, ready to be looked at and to hide light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.first_hit import FirstHit, first_hit
from torchlight.geometry.normals import corner_normals, face_normals
from torchlight.geometry.receiver import receiver_corners
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import LIFT, RayTest, UnitFrame, occlusion_test

OFF_SURFACE = 5 * LIFT  # of the unit frame: along the normal, where a ray leaves a mesh


@dataclass(frozen=True, eq=False)
class Blocker:
    """Triangles that hide light, within a ball that tells which rays need not be cast.

    Attributes:
        center: of the ball, in the unit frame.
        radius: of the ball; negative = there are no triangles.
        hits: the ray test, in the unit frame.
    """

    center: Float[Tensor, "3"]
    radius: float
    hits: RayTest

    def hides(
        self,
        starts: Float[Tensor, "points 3"],
        directions: Float[Tensor, "cells 3"],
        asked: Bool[Tensor, "points cells"],
    ) -> Bool[Tensor, "points cells"]:
        """Returns whether each point is hidden from each direction, False where that is not asked; unit frame."""
        if self.radius < 0:
            return torch.zeros_like(asked)
        towards = self.center - starts
        along = towards @ directions.T
        outside = towards.square().sum(dim=-1, keepdim=True) - self.radius**2
        near = asked & (along > -self.radius) & (along.square() >= outside)
        rays = near.flatten().nonzero()[:, 0]
        result = torch.zeros(near.numel(), dtype=torch.bool)
        if len(rays) > 0:
            point, cell = rays // len(directions), rays % len(directions)
            hit = self.hits(starts[point].numpy(), directions[cell].numpy(), np.inf)
            result[rays] = torch.from_numpy(hit)
        return result.reshape(near.shape)


@dataclass(frozen=True, eq=False)
class Blockers:
    """What hides light: the objects that are there, and the one that is not yet there; in one unit frame."""

    frame: UnitFrame
    old: Blocker
    new: Blocker

    def starts(self, points: Float[Tensor, "points 3"], facing: Float[Tensor, "points 3"]) -> Float[Tensor, "points 3"]:
        """Returns points in the unit frame, lifted off the surface that they lie on, float32."""
        unit = torch.from_numpy(self.frame.to_unit(points.numpy()))
        return (unit + OFF_SURFACE * facing).float()


@dataclass(frozen=True, eq=False)
class Stage:
    """The scene with the new object in it.

    Attributes:
        olds: faces of the objects that are there; the new object's faces have larger numbers.
        facing: unit normal of every face.
        normals: at the corners of every face, for shading.
        eye: the first-hit test of all faces.
        eye_before: the same without the new object.
        over_plane: what hides light from the plane; stretched where the light is near (`light_plane`).
        over_objects: what hides light from points off the plane.
        middle: of the bounding boxes of the old objects and of the new one.
    """

    olds: int
    facing: Float[Tensor, "faces 3"]
    normals: Float[Tensor, "faces 3 3"]
    eye: FirstHit
    eye_before: FirstHit
    over_plane: Blockers
    over_objects: Blockers
    middle: tuple[Float[Tensor, "3"], Float[Tensor, "3"]]


def stage_of(scene: Scene, new: Float[Tensor, "faces 3 3"]) -> Stage:
    """Returns the scene, whose light stands where `light_plane` says, with a new object in it."""
    old = scene.triangles.detach().cpu().double()
    new = new.detach().cpu().double()
    both, corners = torch.cat([old, new]), receiver_corners(scene.receiver)
    over_objects = blockers(old, new, corners)
    over_plane = over_objects
    if scene.light_plane is not None:
        over_plane = blockers(scene.light_plane.stretch(old), scene.light_plane.stretch(new), corners)
    smooth = torch.cat([corner_normals(part) if len(part) else part for part in (old, new)])
    return Stage(
        olds=len(old),
        facing=face_normals(both),
        normals=smooth,
        eye=first_hit(both, corners),
        eye_before=first_hit(old, both.reshape(-1, 3)),
        over_plane=over_plane,
        over_objects=over_objects,
        middle=(middle_of(old), middle_of(new)),
    )


def blockers(
    old: Float[Tensor, "faces 3 3"], new: Float[Tensor, "more 3 3"], bounds: Float[Tensor, "points 3"]
) -> Blockers:
    """Returns both sets of triangles as blockers in the unit frame of all of them and the bounds."""
    everything = torch.cat([old.reshape(-1, 3), new.reshape(-1, 3), bounds.to(old)])
    tests = [occlusion_test(triangles, everything) for triangles in (old, new)]
    frame = tests[0].frame
    balls = [blocker(triangles, frame, test.hits) for triangles, test in zip((old, new), tests, strict=True)]
    return Blockers(frame, *balls)


def blocker(triangles: Float[Tensor, "faces 3 3"], frame: UnitFrame, hits: RayTest) -> Blocker:
    """Returns triangles as a blocker; the ball is that round the bounding box's middle."""
    if len(triangles) == 0:
        return Blocker(torch.zeros(3), -1.0, hits)
    corners = torch.from_numpy(frame.to_unit(triangles.reshape(-1, 3).numpy()))
    center = middle_of(corners[None])
    radius = torch.linalg.vector_norm(corners - center, dim=-1).max().item()
    return Blocker(center.float(), radius * (1 + 1e-4) + OFF_SURFACE, hits)


def middle_of(triangles: Float[Tensor, "*faces 3"]) -> Float[Tensor, "3"]:
    """Returns the middle of the bounding box; the origin where there is none."""
    corners = triangles.reshape(-1, 3)
    if len(corners) == 0:
        return torch.zeros(3, dtype=torch.float64)
    return (corners.amin(dim=0) + corners.amax(dim=0)) / 2
