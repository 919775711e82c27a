"""What the photograph's pixels of matt objects tell of the light: upright faces see what the plane hardly does.

A matt object of one colour shows rho / pi E, E what its surface receives past itself and the other objects. Over the
pixels whose surface faces alike, a facing, v = pi P is averaged first; then, with c = 1 / rho,

    c v = E(x) + e,    covariance of e:  S = s^2 / n + (MATT c)^2 v v' exp(-|n - n'|^2 / 2 ALIKE^2)

s is the spread of a facing's n pixels round what the light makes them; the second part says that no surface is matt to
better than that, and that what is wrong is alike where the surface faces alike. Nobody need know rho: with c left
free, one per channel, the weight of the facings is

    P = S^-1 - S^-1 v v' S^-1 / (v' S^-1 v),    P v = 0: A'PA and -A'PE are what the photograph tells.

The means come first because pixels' noise in v, within S or P, would bias the light by its own size (Peelle's puzzle).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d, normalize

from torchlight.analysis.confidence import pixel_texels
from torchlight.geometry.scene import Scene
from torchlight.insertion.gathering import throw_bounced
from torchlight.insertion.looking import OLD, Seen, look
from torchlight.insertion.rendering import ground_of, top_of
from torchlight.insertion.shading import Material
from torchlight.insertion.sight import Sight, sight_of
from torchlight.insertion.stage import Blockers, Stage, stage_of
from torchlight.light import cubemap, latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.light.grids import LatlongGrid
from torchlight.light.resampling import resample
from torchlight.photo.observation import LinearPhoto

CELLS = 40_000  # squares of the photograph's pixels that are looked at, about
USED = 400  # of them
LOOKS = 5000  # at once
CASTS = 50  # of the cells whose rays are cast at once
ROWS = 128  # of the light as the faces see it: 1.4 degrees
EDGES = 4  # squares along a cube face's edge: normals in one are a facing
FEWEST = 4  # cells of a facing
FLAT = 0.98  # least cosine between the normals of a cell
ALIKE = 0.3  # radians
MATT = 0.02  # of what a facing receives
LEAST = 1e-6  # of the variances: rounding, and faces that are black


@dataclass(frozen=True, eq=False)
class Facings:
    """What is seen of the objects, in cells of some pixels.

    Attributes:
        shown: v = pi P, of every cell.
        facing: number of every cell's facing.
        normals: of the facings.
        transport: V max(0, n.w) dw of every cell, for the pixels of a lat-long of `ROWS` rows above the plane.
        bounced: what every cell receives from the plane.
    """

    shown: Float[Tensor, "3 cells"]
    facing: Int[Tensor, " cells"]
    normals: Float[Tensor, "facings 3"]
    transport: Float[Tensor, "cells pixels"]
    bounced: Float[Tensor, "3 cells"]

    @property
    def counts(self) -> Float[Tensor, " facings"]:
        """Cells of every facing."""
        return self.facing.bincount(minlength=len(self.normals)).double()

    def means(self, values: Float[Tensor, "cells columns"]) -> Float[Tensor, "facings columns"]:
        """Returns the mean over every facing's cells."""
        sums = values.new_zeros(len(self.normals), values.shape[1]).index_add_(0, self.facing, values)
        return sums / self.counts[:, None]


def facings_of(photo: LinearPhoto, scene: Scene, light: EnvironmentMap, bounce: bool = False) -> Facings | None:
    """Returns what a photograph shows of the scene's objects; None where that is less than two facings.

    Args:
        photo: linear; rectified where the scene has no camera.
        scene: with objects that are matt and of one colour.
        light: far away, that explains the plane: for what the plane throws back.
        bounce: whether that counts.
    """
    nothing = scene.triangles[:0]
    height, width = photo.radiance.shape[-2:]
    sight = sight_of(scene, (width, height), top_of(scene, nothing))
    sight = sight.coarser(max(1, round((height * width / CELLS) ** 0.5)))
    stage = stage_of(scene, nothing)
    index = old_cells(photo, stage, sight)
    seen = look(stage, sight, index)
    number = normal_squares(seen.normals[:, 0])
    kept = is_flat(seen) & ((number[:, None] == number).sum(dim=1) >= FEWEST)
    squares, facing = number[kept].unique(return_inverse=True)
    if len(squares) < 2:
        return None
    seen = seen.only(kept, OLD)
    shown = torch.pi * _cell_means(photo.radiance.double(), sight.step)[:, index[kept]]
    bounced = thrown_by_plane(seen, stage, scene, light) if bounce else torch.zeros_like(shown)
    middles = torch.zeros(len(squares), 3, dtype=torch.float64).index_add_(0, facing, seen.normals[:, 0])
    return Facings(shown, facing, normalize(middles, dim=1), transport_of(seen, stage.over_objects), bounced)


def thrown_by_plane(seen: Seen, stage: Stage, scene: Scene, light: EnvironmentMap) -> Float[Tensor, "3 cells"]:
    """Returns what every cell receives from the plane, as an inserted object would with one bounce."""
    ground = ground_of(scene, light, scene.triangles[:0])
    return throw_bounced(seen, ground, stage.over_objects, Material()).irradiance.T


def telling(
    facings: Facings, light: EnvironmentMap, resolution: int
) -> list[tuple[Float[Tensor, "texels texels"], Float[Tensor, " texels"]]]:
    """Returns A'PA and A'P (c v - E) of every channel, round a light: to be added to what the plane tells.

    Args:
        facings: what is seen.
        light: far away, in the photograph's units.
        resolution: of the texels.
    """
    columns = facings.means(texel_columns(facings.transport, resolution))
    received = radiance_above(light) @ facings.transport.T + facings.bounced
    told = []
    for shown, lit in zip(facings.shown, received, strict=True):
        weight, _, e = weighed(facings, shown, lit)
        told.append((columns.T @ weight @ columns, -columns.T @ (weight @ e)))
    return told


def weighed(
    facings: Facings, shown: Float[Tensor, " cells"], received: Float[Tensor, " cells"]
) -> tuple[Float[Tensor, "facings facings"], Float[Tensor, " facings"], Float[Tensor, " facings"]]:
    """Returns P, v and E of a channel's facings; P is 0 where the objects are black.

    Args:
        facings: what is seen.
        shown: pi P, of every cell.
        received: E by the light that is there, of every cell.
    """
    v, e = facings.means(torch.stack([shown, received], dim=1)).T
    if not float(v @ e) > 0:
        return torch.zeros(len(v), len(v)).to(v), v, e
    c = (v @ e) / (v @ v)  # about: S is to have the units of E
    left = c * (shown - v[facings.facing]) - (received - e[facings.facing])
    spread = facings.means(left.square()[:, None])[:, 0] / (facings.counts - 1)
    alike = torch.exp(-torch.cdist(facings.normals, facings.normals).square() / (2 * ALIKE**2))
    covariance = (MATT * c) ** 2 * v[:, None] * v * alike
    covariance.diagonal().add_(spread + LEAST * covariance.diagonal().mean())
    weight = torch.linalg.inv(covariance)
    along = weight @ v
    return weight - along[:, None] * along / (v @ along), v, e


def old_cells(photo: LinearPhoto, stage: Stage, sight: Sight) -> Int[Tensor, " cells"]:
    """Returns cells that show nothing but usable pixels of the objects, and so do all around them; at most `USED`."""
    columns, rows = sight.grid
    kinds = [look(stage, sight, part).kind for part in torch.arange(sight.cells).split(LOOKS)]
    whole = (torch.cat(kinds) == OLD).all(dim=1).reshape(rows, columns)
    usable = _cell_means(photo.usable.double()[None], sight.step)[0].reshape(rows, columns) == 1
    apart = max_pool2d((~(whole & usable)).double()[None, None], 3, 1, 1)[0, 0] > 0
    index = (~apart).flatten().nonzero()[:, 0]
    return index[torch.linspace(0, len(index) - 1, min(len(index), USED)).long()]


def is_flat(seen: Seen) -> Bool[Tensor, " cells"]:
    """Returns the cells that show no edge."""
    return (seen.normals @ seen.normals[:, 0, :, None] > FLAT).all(dim=1)[:, 0]


def normal_squares(normals: Float[Tensor, "cells 3"]) -> Int[Tensor, " cells"]:
    """Returns the square of a cube map of `EDGES` along an edge that each normal points at."""
    return cubemap.texel_index(normals, EDGES)


def transport_of(seen: Seen, blockers: Blockers) -> Float[Tensor, "cells pixels"]:
    """Returns V max(0, n.w) dw for the pixels of a lat-long above the plane, float64."""
    above = latlong.pixel_directions(ROWS)[: ROWS // 2].reshape(-1, 3).float()
    angles = latlong.row_solid_angles(ROWS)[: ROWS // 2].double().repeat_interleave(2 * ROWS)
    starts = blockers.starts(seen.points[:, 0], seen.facing[:, 0])

    def cast(part: Tensor) -> Float[Tensor, "part pixels"]:
        cosine = (seen.normals[part, 0].float() @ above.T).clamp(min=0)
        asked = (cosine > 0) & (seen.facing[part, 0].float() @ above.T > 0)
        free = asked & ~blockers.old.hides(starts[part], above, asked)
        return (cosine * free).double() * angles

    return torch.cat([cast(part) for part in torch.arange(len(starts)).split(CASTS)])


def texel_columns(transport: Float[Tensor, "cells pixels"], resolution: int) -> Float[Tensor, "cells texels"]:
    """Returns the transport of even light within each visible texel."""
    texel = pixel_texels(resolution, ROWS).flatten()
    inside = texel >= 0
    columns = transport.new_zeros(len(transport), 3 * resolution**2)
    return columns.index_add_(1, texel[inside], transport[:, inside])


def radiance_above(light: EnvironmentMap) -> Float[Tensor, "3 pixels"]:
    """Returns the radiance above the plane of a lat-long of `ROWS` rows, float64."""
    source, target = LatlongGrid(light.height), LatlongGrid(ROWS)
    moved = resample(light.radiance.double().flatten(start_dim=1), source, target)
    return moved[:, : moved.shape[1] // 2]


def _cell_means(values: Float[Tensor, "channels height width"], step: int) -> Float[Tensor, "channels cells"]:
    """Returns means over squares of pixels; the last of a row or column may be cut."""
    pooled = avg_pool2d(values[None], step, ceil_mode=True, count_include_pad=False)
    return pooled[0].flatten(start_dim=1)
