"""Light that a dark object of known albedo throws back on the sheet, found from the photograph and taken away.

No shadow makes the sheet brighter than it is far from the object; what the object throws back does. To first order

    E(x) = sum over texels (T + r R) L,    R(x, w) = sum over faces f of F_f(x) m_f(w),
    m_f(w) = integral of max(0, n_f . w) d w + (1 - n_f,z) / 2 a integral of max(0, w_z) d w:

a face of normal n_f and albedo r is lit by the sky and by the sheet of albedo a below it, and is as bright all over;
F is Lambert's form factor. For a convex object on the plane the sky's share is exact; the sheet's leaves out the
object's own shadow. A gloss counts as albedo.

The albedo r must be stated: a photograph does not tell it. Under an even sky of radiance c the object hides
pi c F(x) of it, F the sum of all F_f; with faces of radiance c it gives as much back and cannot be seen. So light from
straight above, which no sample loses, looks like an even sky whose object shines, and every r up to 1 or so explains
the photograph, each with a light of its own. For the same reason T + r R is not solved as one system, not even for
the true r: texels near the horizon hardly light the sheet but fully light the faces, and would serve as a lamp for each
face. The light is found from T alone instead, and lights the faces from above `LOWEST` only, where
n_f . w <= w_z / tan(LOWEST). What is taken away is thus never more than

    r F(x) E (1 / tan(LOWEST) + a / 2),    E the unshadowed irradiance of the light found,

and rather too little: light found from T alone already lacks some of the shade that the object fills.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.footprints import footprint_points
from torchlight.geometry.form_factors import form_factors
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.photo.observation import Observation
from torchlight.relighting import albedo_over_pi
from torchlight.solvers import NNLS, LeastSquares
from torchlight.transfer import Transfer

WHITE_PAPER = 0.8  # albedo of the sheet where it is not known
LOWEST = math.radians(10.0)  # elevation above which light counts for the faces; 6 to 15 degrees do about alike
SUBPOINTS = 2  # along a footprint's edge
PARTS = 4  # along a texel's edge
FACES_AT_ONCE = 32  # of the object
FLAT = 1e-5  # of the object's size: a corner this little before a face is on it, as corners are float32


def thrown_back(
    observation: Observation, scene: Scene, transfer: Transfer, albedo: float
) -> Float[Tensor, "*batch channels points"]:
    """Returns what a dark object throws back on the sheet: its share of the photographs' samples, in their units.

    Args:
        observation: samples and weights.
        scene: a convex object on the plane, and the receiver.
        transfer: of the scene, of 16 texels or so.
        albedo: of the object, its gloss included.

    Raises:
        ConfigError: the albedo is not in [0, 1).
        SceneError: the object is not convex.
    """
    if not 0.0 <= albedo < 1.0:
        raise ConfigError(f"albedo of the object: expected a number in [0, 1), got {albedo}")
    if not is_convex(scene.triangles):
        raise SceneError("light thrown back is known for one convex object only; give no albedo for this one")
    bounce = bounced_transport(scene, transfer.resolution, LOWEST).to(transfer.transport)
    factor = albedo_over_pi(scene.receiver, observation.samples)
    received = (observation.samples / factor).to(bounce)
    light = NNLS().solve(LeastSquares(transfer.transport, received, observation.weights.to(bounce))).coefficients
    return (albedo * (light.to(bounce) @ bounce.T) * factor).to(observation.samples)


def without(observation: Observation, thrown: Float[Tensor, "*batch channels points"]) -> Observation:
    """Returns the observation less what the object throws back; 0 where the weight is 0."""
    used = (observation.weights > 0)[..., None, :]
    rest = observation.samples - thrown
    return replace(observation, samples=torch.where(used, rest, torch.zeros_like(rest)))


def is_convex(triangles: Float[Tensor, "faces 3 3"]) -> bool:
    """Returns whether no corner lies before any face: one convex body, corners counter-clockwise from outside."""
    corners = triangles.double().reshape(-1, 3).unique(dim=0)
    size = (corners.amax(dim=0) - corners.amin(dim=0)).max()
    return all(
        bool((corners @ outward.T - (part[:, 0] * outward).sum(dim=-1)).max() <= FLAT * size)
        for part in triangles.double().split(FACES_AT_ONCE)
        for outward in (face_normals(part),)
    )


def face_normals(triangles: Float[Tensor, "faces 3 3"]) -> Float[Tensor, "faces 3"]:
    """Returns the unit normals of triangles, outwards."""
    across = torch.linalg.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return torch.nn.functional.normalize(across, dim=-1)


def bounced_transport(scene: Scene, resolution: int, lowest: float = 0.0) -> Float[Tensor, "points texels"]:
    """Returns R: the irradiance that an object of albedo 1 throws on every sample under each texel of radiance 1.

    Args:
        scene: a convex object on the plane, and the receiver.
        resolution: texels along a cube map face's edge.
        lowest: elevation in radians from which on light counts that comes straight to the faces.
    """
    points = footprint_points(scene.receiver, SUBPOINTS)
    cells = cubemap.cut(cubemap.whole_texels(resolution), PARTS)
    directions, angles = cubemap.cell_directions(cells), cubemap.cell_solid_angles(cells)
    angles = angles * (directions[..., 2] > math.sin(lowest))
    sheet = WHITE_PAPER if scene.receiver.albedo is None else sum(scene.receiver.albedo) / 3
    from_sheet = sheet / 2 * cubemap.cell_cosine_weights(cells).sum(dim=-1)
    bounced = torch.zeros(len(points), len(from_sheet), dtype=torch.float64)
    for part in scene.triangles.double().split(FACES_AT_ONCE):
        factors = form_factors(part, points.reshape(-1, 3)).reshape(*points.shape[:2], -1).mean(dim=1)
        normals = face_normals(part)
        direct = torch.einsum("tcs,fs->ftc", directions, normals).clamp(min=0)
        bounced += factors @ ((direct * angles).sum(dim=-1) + (1 - normals[:, 2:]) * from_sheet)
    return bounced
