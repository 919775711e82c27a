"""The edges that can bound a shadow: what visibility of the plane z = 0 needs of a triangle soup, prepared once.

Seen along d, the plane point q is hidden when its line meets at least one triangle. Let sigma_f = sign(n_f . d) be the
facing of face f and w_f(q) the winding number of its projection round q; then sigma_f w_f is 1 inside the projected
face and 0 outside, and the number of sheets over q is

    sheets(q) = sum over faces of sigma_f w_f(q) = sum over edges e of n_e(d) [crossings of e left of q]
    n_e(d)    = sum over the faces f of e of o_ef sigma_f,   o_ef = 1 where f runs along e, -1 where against it.

Two faces of equal facing cancel, so that only contours (n_e = 2 or -2) and open edges (1 or -1) are left. Nothing is
asked of the soup: it may be open, non-manifold, turned inside out or several objects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.geometry.receiver import receiver_corners
from torchlight.geometry.scene import Scene, shadowing
from torchlight.geometry.soup import distinct, same_rows, weld
from torchlight.geometry.visibility import LIFT, unit_frame

CLUSTER = 16  # edges whose facing is decided together
MORTON_BITS = 10

Points = Float[np.ndarray, "points 3"]
Corners = Int[np.ndarray, "faces 3"]


@dataclass(frozen=True, eq=False)
class Contours:
    """The edges of occluders above the plane, neighbours in attitude next to each other.

    Attributes:
        faces: the occluders above the plane, without double and degenerate faces.
        ends: both ends of every edge, in the scene's unit.
        normals: unit normals of the one or two faces that share it; 0 for no face.
        sides: o_ef of these faces; 0 for no face.
        first: where each cluster of edges begins, and the number of edges.
        axes: the middle of each cluster's normals, up to sign.
        spread: the largest angle between that axis and a normal's line, in radians; pi where an edge may be open.
    """

    faces: Float[np.ndarray, "faces 3 3"]
    ends: Float[np.ndarray, "edges 2 3"]
    normals: Float[np.ndarray, "edges 2 3"]
    sides: Float[np.ndarray, "edges 2"]
    first: Int[np.ndarray, " bounds"]
    axes: Float[np.ndarray, "clusters 3"]
    spread: Float[np.ndarray, " clusters"]


def scene_contours(scene: Scene) -> Contours:
    """Returns the edges that bound shadows of a scene's occluders, as distant light is to see them (`shadowing`).

    What reaches less than `LIFT` of its size above z = 0 lies in it.
    """
    scene = shadowing(scene)
    corners = torch.cat([scene.triangles.reshape(-1, 3), receiver_corners(scene.receiver).to(scene.triangles)])
    return prepare(scene.triangles, LIFT / unit_frame(corners).scale)


def prepare(triangles: Float[Tensor, "faces 3 3"], lift: float) -> Contours:
    """Returns the edges of a triangle soup above z = 0.

    Args:
        triangles: in the scene's unit.
        lift: corners no farther than this from the plane are moved onto it (a turned solid rests there up to
            rounding).
    """
    soup = triangles.detach().double().cpu().numpy() + 0.0  # a copy without negative zeros
    soup[..., 2][abs(soup[..., 2]) <= lift] = 0.0
    points, faces = weld(soup)
    points, faces = clip(points, distinct(faces))
    normals, faces = unit_normals(points, faces)
    start_end, pairs, sides = edge_pairs(points, faces, normals)
    both = np.where(sides[..., None] == 0, 0.0, np.take(normals, pairs, axis=0))
    flat = same_rows(both[:, 0], both[:, 1]) & (sides[:, 0] + sides[:, 1] == 0)
    bent = np.flatnonzero(~flat)
    start_end, both, sides = (np.take(part, bent, axis=0) for part in (start_end, both, sides))
    return clustered(np.take(points, faces, axis=0), np.take(points, start_end, axis=0), both, sides)


def clip(
    points: Points, faces: Corners
) -> tuple[Float[np.ndarray, "more_points 3"], Int[np.ndarray, "clipped_faces 3"]]:
    """Returns the part of the faces above z = 0; a cut edge gets one new corner, the same for all its faces."""
    above, below = points[:, 2] > 0, points[:, 2] < 0
    faces = faces[above[faces].any(axis=1)]
    crossing = below[faces].any(axis=1)
    kept, cut = faces[~crossing], faces[crossing]
    ends = np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1)
    split = (above[ends].any(axis=-1)) & (below[ends].any(axis=-1))
    pairs, number = np.unique(np.sort(ends[split], axis=-1), axis=0, return_inverse=True)
    low, high = points[pairs[:, 0]], points[pairs[:, 1]]
    middle = low + (high - low) * (low[:, 2] / (low[:, 2] - high[:, 2]))[:, None]
    middle[:, 2] = 0.0
    between = np.full(cut.shape, -1, dtype=np.int64)
    between[split] = len(points) + number.reshape(-1)
    # corners in turn, each followed by the cut that lies on the edge after it: 3 or 4 of the 6 remain
    ring = np.stack([np.where(below[cut], -1, cut), between], axis=-1).reshape(-1, 6)
    ring = np.take_along_axis(ring, np.argsort(ring < 0, axis=1, kind="stable"), axis=1)
    quads = ring[ring[:, 3] >= 0]
    return np.concatenate([points, middle]), np.concatenate([kept, ring[:, :3], quads[:, [0, 2, 3]]])


def unit_normals(
    points: Points, faces: Corners
) -> tuple[Float[np.ndarray, "kept_faces 3"], Int[np.ndarray, "kept_faces 3"]]:
    """Returns the unit normals, and the faces that have one."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    some = length > 0
    return normals[some] / length[some, None], faces[some]


def edge_pairs(
    points: Points, faces: Corners, normals: Float[np.ndarray, "faces 3"]
) -> tuple[Int[np.ndarray, "edges 2"], Int[np.ndarray, "edges 2"], Float[np.ndarray, "edges 2"]]:
    """Returns each edge's ends, its one or two faces and their sides (0 = no second face).

    Where more than two faces share an edge they are paired by their angle about it and the edge appears once per
    pair; any pairing gives the same sum, alike faces give the fewest contours.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    face = np.repeat(np.arange(len(faces)), 3)
    key = low * len(points) + high
    order = in_pairs(key, lambda few: angle_about(points[high[few]] - points[low[few]], normals[face[few]]))
    low, high, key, face = low[order], high[order], key[order], face[order]
    side = np.where(start[order] == low, 1.0, -1.0)
    place = np.arange(len(key))
    begins = np.r_[True, key[1:] != key[:-1]][: len(key)]
    rank = place - np.maximum.accumulate(np.where(begins, place, 0))
    first = place[rank % 2 == 0]
    second = np.minimum(first + 1, len(key) - 1)
    paired = (second > first) & (key[second] == key[first])
    pairs = np.stack([face[first], np.where(paired, face[second], face[first])], axis=1)
    sides = np.stack([side[first], np.where(paired, side[second], 0.0)], axis=1)
    return np.stack([low[first], high[first]], axis=1), pairs, sides


def in_pairs(
    key: Int[np.ndarray, " sides"], angle: Callable[[Int[np.ndarray, " few"]], Float[np.ndarray, " few"]]
) -> Int[np.ndarray, " sides"]:
    """Returns the order of the keys, and of those that appear more than twice the order of their angles, in turn."""
    order = np.argsort(key)
    ordered = key[order]
    thrice = ordered[np.flatnonzero(ordered[2:] == ordered[:-2])]
    few = np.flatnonzero(np.isin(ordered, thrice)) if len(thrice) else thrice
    order[few] = order[few][np.lexsort((angle(order[few]), ordered[few]))]
    return order


def angle_about(edges: Points, normals: Points) -> Float[np.ndarray, " points"]:
    """Returns the angle of each normal's line about its edge in [0, pi), from a zero that only the edge decides."""
    smallest = np.eye(3)[abs(edges).argmin(axis=1)]
    across = np.cross(edges, smallest)
    along = np.cross(edges, across) / np.linalg.norm(edges, axis=1, keepdims=True)
    return np.arctan2((normals * along).sum(axis=1), (normals * across).sum(axis=1)) % np.pi


def clustered(
    faces: Float[np.ndarray, "faces 3 3"],
    ends: Float[np.ndarray, "edges 2 3"],
    normals: Float[np.ndarray, "edges 2 3"],
    sides: Float[np.ndarray, "edges 2"],
) -> Contours:
    """Returns the edges sorted by bend and attitude and cut into clusters, those with one face last."""
    towards = np.ascontiguousarray((normals * (sides * [1.0, -1.0])[..., None]).transpose(1, 2, 0))
    towards *= np.where(towards[0, 2] + towards[1, 2] < 0, -1.0, 1.0)  # equal for two coplanar faces of one surface
    axis = towards[0] + towards[1]
    length = np.sqrt((axis * axis).sum(axis=0))
    axis = np.divide(axis, length, out=np.zeros_like(axis), where=length > 0)
    bend = np.arccos(np.clip((towards[0] * towards[1]).sum(axis=0), -1.0, 1.0))
    octave = np.ceil(np.log2(np.maximum(np.degrees(bend), 1.0))).astype(np.int64)  # 0 to 8
    place = ((sides[:, 1] == 0) * 16 + octave) * 4**MORTON_BITS + morton(axis.T)
    order = np.argsort(place)
    axis, towards = np.take(axis, order, axis=1), np.take(towards, order, axis=2)
    first = np.arange(0, len(order), CLUSTER)
    middle = np.add.reduceat(axis, first, axis=1) if len(first) else np.zeros((3, 0))
    middle /= np.maximum(np.sqrt((middle * middle).sum(axis=0)), 1e-300)
    own = np.repeat(middle, CLUSTER, axis=1)[:, : len(order)]
    turned = np.where((own * axis).sum(axis=0) < 0, -1.0, 1.0)
    cosine = np.minimum((towards[0] * own).sum(axis=0) * turned, (towards[1] * own).sum(axis=0) * turned)
    narrowest = np.minimum.reduceat(cosine, first) if len(first) else np.zeros(0)
    spread = np.where(narrowest > 0, np.arccos(np.clip(narrowest, -1, 1)), np.pi)
    ends, normals, sides = (np.take(part, order, axis=0) for part in (ends, normals, sides))
    return Contours(faces, ends, normals, sides, np.r_[first, len(order)], np.ascontiguousarray(middle.T), spread)


def morton(axes: Points) -> Int[np.ndarray, " points"]:
    """Returns the place of each upper unit vector on a Z-shaped curve through the equal-area disc."""
    disc = axes[:, :2] / np.sqrt(1 + np.maximum(axes[:, 2:], 0))
    cell = np.clip((disc + 1) / 2 * 2**MORTON_BITS, 0, 2**MORTON_BITS - 1).astype(np.int64)
    code = np.zeros(len(axes), dtype=np.int64)
    for bit in range(MORTON_BITS):
        code |= ((cell[:, 0] >> bit) & 1) << (2 * bit) | ((cell[:, 1] >> bit) & 1) << (2 * bit + 1)
    return code
