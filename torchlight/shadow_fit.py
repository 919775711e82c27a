"""A photograph explained with the object at one pose, and what moving the object would change.

With q the pose, c the light of the adaptive method, A the columns of the squares that shine, P the projection on the
span of W^(1/2) A and r = W^(1/2) (A c - b),

    J = (1 - P) W^(1/2) (dA/dq) c

is the derivative of r where the light follows the pose, without the term that is proportional to r (Kaufman, BIT 15,
1975): what light on these squares can do as well as a movement is projected away.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight import metrics
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import rotation_matrix
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.linear import solve
from torchlight.inversion.nodes import LEAST_CELLS, NodeColumns
from torchlight.inversion.quadtree import pyramid, squares
from torchlight.inversion.refinement import needed
from torchlight.photo.observation import Observation
from torchlight.precomputation import deepened, precompute
from torchlight.relighting import albedo_over_pi
from torchlight.solvers import NNLS
from torchlight.transfer import square_columns

DIFFERENCE = 0.5  # of a footprint: the shadow's edge is averaged over one, so that smaller differences gain nothing
CELLS_PER_EDGE = 96  # directions along a face's edge, for differences
BLOCKS = 8  # along each side of the receiver, within which residuals may be correlated
SHINING = 1e-9  # of the brightest square
ROUNDING = 1e-6  # of the brightest sample: the least noise there is in float32

Look = Callable[[Scene], Observation]
Pose = Float[Tensor, "3"]


@dataclass(frozen=True, eq=False)
class Frame:
    """The stated scene, and what one unit of each parameter is: no point of the object moves beyond a footprint.

    Attributes:
        scene: as stated.
        middle: the occluders' centroid by area; turns go about the vertical through it.
        unit: x, y in the scene's unit, turn in radians.
    """

    scene: Scene
    middle: Float[Tensor, "2"]
    unit: Pose


@dataclass(frozen=True, eq=False)
class Fit:
    """A photograph explained with the object at one pose.

    Attributes:
        pose: q in units of the frame.
        columns: of that pose.
        observation: of one channel.
        leaves: all squares on which the light is constant.
        squares: those that shine.
        radiance: of these.
        matrix: W^(1/2) A.
        residual: W^(1/2) (A c - b).
    """

    pose: Pose
    columns: NodeColumns
    observation: Observation
    leaves: Int[Tensor, " leaves"]
    squares: Int[Tensor, "shining 4"]
    radiance: Float[Tensor, " shining"]
    matrix: Float[Tensor, "points shining"]
    residual: Float[Tensor, " points"]

    @property
    def cost(self) -> float:
        """|r|^2."""
        return float(self.residual.square().sum())

    @property
    def rms_255(self) -> float:
        """Root mean square of the residual, the brightest sample being 255."""
        weights = self.observation.weights
        brightest = metrics.brightest(self.observation.samples, weights)
        return 255 * math.sqrt(self.cost / float((weights > 0).sum())) / float(brightest)


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations of one fit, in units of the frame.

    Attributes:
        values: eigenvalues of J'J.
        vectors: its eigenvectors, in columns.
        determined: those along which independent noise leaves the pose known to better than one unit.
        gradient: J'r.
        covariance: of the pose.
    """

    values: Float[Tensor, "3"]
    vectors: Float[Tensor, "3 3"]
    determined: Bool[Tensor, "3"]
    gradient: Pose
    covariance: Float[Tensor, "3 3"]


def frame_of(scene: Scene) -> Frame:
    """Returns the stated pose's frame."""
    triangles = scene.triangles.double()
    area = torch.linalg.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).norm(dim=1)
    middle = ((triangles.mean(dim=1) * area[:, None]).sum(dim=0) / area.sum())[:2]
    radius = float((triangles[..., :2] - middle).norm(dim=-1).max())
    footprint = min(scene.receiver.footprint)
    return Frame(scene, middle, torch.tensor([footprint, footprint, footprint / radius], dtype=torch.float64))


def at(frame: Frame, pose: Pose) -> Scene:
    """Returns the scene with the occluders at a pose: R (p - m) + m + t."""
    x, y, turn = (pose * frame.unit).tolist()
    rotation = rotation_matrix((0.0, 0.0, math.degrees(turn)))
    middle = torch.cat([frame.middle, frame.middle.new_zeros(1)])
    offset = middle + torch.tensor([x, y, 0.0], dtype=torch.float64)
    return replace(frame.scene, triangles=(frame.scene.triangles.double() - middle) @ rotation.T + offset)


def grey(observation: Observation, receiver: Receiver) -> Observation:
    """Returns the mean of the channels' irradiances, as one channel."""
    received = observation.samples.double() / albedo_over_pi(receiver, observation.samples.double())
    return Observation(received.mean(dim=-2, keepdim=True).cpu(), observation.weights.double().cpu())


def solved(frame: Frame, pose: Pose, look: Look, settings: AdaptiveHaar) -> Fit:
    """Returns the photograph explained with the object at a pose, as the photograph shows the plane then."""
    scene = at(frame, pose)
    return fitted(pose, cast(scene, settings), grey(look(scene), scene.receiver), settings)


def cast(scene: Scene, settings: AdaptiveHaar) -> NodeColumns:
    """Returns the columns of a scene, which no other photograph will ask for."""
    return deepened(scene, precompute(scene, settings.dense_resolution, use_cache=False), settings.max_resolution)


def fitted(pose: Pose, columns: NodeColumns, observation: Observation, settings: AdaptiveHaar) -> Fit:
    """Returns the light of the adaptive method that explains an observation."""
    found = solve_adaptive(columns, observation, settings)
    tree = columns.tree
    leaves = tree.leaves(needed(tree, found.refinement.kept[0]))
    texels = settings.basis.synthesis(found.solution.coefficients[0].double())
    radiance = pyramid(texels, tree.resolution)[leaves] / pyramid(torch.ones_like(texels), tree.resolution)[leaves]
    return explained(pose, columns, observation, leaves, radiance)


def followed(fit: Fit, pose: Pose, columns: NodeColumns, observation: Observation, settings: AdaptiveHaar) -> Fit:
    """Returns the light of the adaptive method, or the one on the squares of a fit before, whichever explains more.

    The adaptive method's choice of squares is a matter of luck that would hide what a small step gains.
    """
    radiance = solve(columns.of(fit.leaves).T, observation, NNLS()).coefficients[0].double()
    trials = fitted(pose, columns, observation, settings), explained(pose, columns, observation, fit.leaves, radiance)
    return min(trials, key=lambda trial: trial.cost)


def explained(
    pose: Pose,
    columns: NodeColumns,
    observation: Observation,
    leaves: Int[Tensor, " leaves"],
    radiance: Float[Tensor, " leaves"],
) -> Fit:
    """Returns the fit of a light that is constant on squares."""
    shining = radiance > SHINING * radiance.max()
    nodes, root = leaves[shining], observation.weights.sqrt()
    matrix = (columns.of(nodes) * root).T
    residual = matrix @ radiance[shining] - observation.samples[0] * root
    shape = squares(columns.tree, nodes)
    return Fit(pose, columns, observation, leaves, shape, radiance[shining], matrix, residual)


def seen_again(frame: Frame, fit: Fit, look: Look, settings: AdaptiveHaar) -> Fit:
    """Returns the fit to what the photograph shows of the plane with the object where it now is."""
    scene = at(frame, fit.pose)
    now, before = grey(look(scene), scene.receiver), fit.observation
    if torch.equal(now.weights, before.weights) and torch.equal(now.samples, before.samples):
        return fit
    return followed(fit, fit.pose, fit.columns, now, settings)


def shown(scene: Scene, fit: Fit) -> Float[Tensor, " points"]:
    """Returns the irradiance under the light of a fit with the object elsewhere."""
    total = torch.zeros(scene.receiver.points, dtype=torch.float64)
    levels = fit.squares[:, 1]
    for level in levels.unique().tolist():
        here, cells = levels == level, max(LEAST_CELLS, CELLS_PER_EDGE >> level)
        total += fit.radiance[here] @ square_columns(scene, fit.squares[here], cells)
    return total


def jacobian(frame: Frame, fit: Fit) -> Float[Tensor, "points 3"]:
    """Returns J per unit of the frame: what moving the object does that no light on the shining squares does."""
    root, slopes = fit.observation.weights.sqrt(), []
    for step in DIFFERENCE * torch.eye(3, dtype=torch.float64):
        ahead, behind = shown(at(frame, fit.pose + step), fit), shown(at(frame, fit.pose - step), fit)
        slopes.append(root * (ahead - behind) / (2 * DIFFERENCE))
    raw = torch.stack(slopes, dim=1)
    span = torch.linalg.qr(fit.matrix).Q
    return raw - span @ (span.T @ raw)


def linearized(frame: Frame, fit: Fit) -> Normal:
    """Returns the normal equations of a fit.

    The covariance is s^2 (J'J)^-1, s^2 the residual's variance, plus (J'J)^-1 G (J'J)^-1 with G the sum over blocks of
    samples of g g', g = J'r of the block: the first is what noise does, the second what a light that is never exact
    does, whose residuals are alike next to each other (Liang and Zeger, Biometrika 73, 1986).
    """
    J = jacobian(frame, fit)
    values, vectors = torch.linalg.eigh(J.T @ J)
    values = values.clamp(min=torch.finfo(values.dtype).tiny ** 0.5)
    used = int((fit.observation.weights > 0).sum())
    least = (ROUNDING * float(fit.observation.samples.max())) ** 2
    variance = max(least, fit.cost / max(1, used - len(fit.radiance) - 3))
    inverse = vectors / values @ vectors.T
    blocks = block_sums(J * fit.residual[:, None], frame.scene.receiver)
    covariance = variance * inverse + inverse @ (blocks.T @ blocks) @ inverse
    return Normal(values, vectors, variance / values < 1, J.T @ fit.residual, covariance)


def block_sums(values: Float[Tensor, "points fields"], receiver: Receiver) -> Float[Tensor, "blocks fields"]:
    """Returns the sums over each block of the receiver."""
    columns, rows = receiver.samples
    column = torch.arange(columns) * BLOCKS // columns
    row = torch.arange(rows) * BLOCKS // rows
    block = (row[:, None] * BLOCKS + column).reshape(-1)
    return torch.zeros(BLOCKS**2, values.shape[1], dtype=values.dtype).index_add_(0, block, values)


def significance(pose: Pose, normal: Normal) -> float:
    """Returns a movement in units of its deviation: sqrt(q' C^-1 q) over the directions that are determined."""
    if not bool(normal.determined.any()):
        return 0.0
    axes = normal.vectors[:, normal.determined]
    along = axes.T @ pose
    return math.sqrt(float(along @ torch.linalg.solve(axes.T @ normal.covariance @ axes, along)))
