"""Where the object really stands, from its outline in the photograph: its place on the plane and its turn.

    q = (x, y, turn about the vertical through the object's middle),    r_i(q) = n_i . (p_i(q) - e_i)

p_i are samples of the outline as the scene predicts it, n_i its normals there, e_i the edge of the photograph that the
normal meets (`photo.edges`): how far, in pixels, the outline lies from it.

A photograph is full of other edges: shadows, print, the object's own. So the first pose is voted for. Within a trusted
distance of the stated pose every pose of a grid gets from every sample one vote as large as exp(-r^2 / 2 s^2) for the
nearest edge, s the grid's spacing; edges that belong to nothing vote for no pose in common. From the best one
Gauss-Newton steps with Huber's weights follow (Huber, Annals of Mathematical Statistics 35, 1964), the outline and its
edges found anew for each.

All occluders move as one. The object's size and height and the camera are taken as stated; where one is wrong, the
place that is found is wrong with them, and the deviations do not know it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.camera import Camera
from torchlight.errors import CalibrationError, ConfigError
from torchlight.geometry.contours import Contours, prepare
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import LIFT, OcclusionTest, scene_occlusion
from torchlight.photo.edges import Found, edges_across, slope_noise
from torchlight.photo.observation import LinearPhoto
from torchlight.placement.outline import Outline, outline, sensitivity
from torchlight.placement.outline_step import IMMOBILE, NEAR, SECTORS, Matched, Normal, normal_equations, reach_of
from torchlight.placement.report import Placement
from torchlight.shadow_fit import Frame, Pose, at, frame_of

TRUSTED = 0.15  # of the object's largest extent: who is farther off should mend the scene file
MAX_STEPS = 12
STILL = 0.02  # pixels
SUFFICIENT = 0.25  # of the cost: what a movement must take away, or the object is not of the stated shape
DOUBT = 4.0  # deviations that a movement must exceed to be believed
LEAST_SEEN = 1 / 3  # of the outline in the frame: with edges
LEAST_FRAMED = 1 / 2  # of the outline: in the frame
LEAST_EDGES = 30
GRID = 21  # poses along each parameter, at most


@dataclass(frozen=True, eq=False)
class Sight:
    """What does not change while the object is looked for.

    Attributes:
        frame: the stated scene; one unit of a parameter moves a point of the object by a pixel at most, about.
        camera: of the stated scene.
        contours: of the stated occluders.
        test: the same.
        grey: the photograph, mean of its channels.
        noise: of its slopes.
        reach: the trusted distance, in pixels.
    """

    frame: Frame
    camera: Camera
    contours: Contours
    test: OcclusionTest
    grey: Float[Tensor, "height width"]
    noise: float
    reach: float


def check_seen(scene: Scene) -> None:
    """Raises ConfigError where a scene has no camera that sees its occluders."""
    if scene.camera is None and scene.finder is None:
        raise ConfigError(
            "--refine-pose silhouette: the scene has no camera, so that its photographs do not show the object; "
            "use --refine-pose shadow"
        )


def refine(scene: Scene, photo: LinearPhoto) -> tuple[Scene, Placement]:
    """Returns the scene with its occluders where the photograph shows them, and how far that is from where they were.

    The scene is left as it was, and the report says why, where less than half of the outline is in the frame, where
    the best place lies farther away than `TRUSTED` of the object's size, where too little of the outline has an edge,
    where the movement does not exceed `DOUBT` of its deviations, or where it takes less than `SUFFICIENT` of the
    distance to edges away. What leaves the outline where it is, such as the turn of a round object, is not changed.

    Args:
        scene: as stated, with the photograph's camera.
        photo: linear photograph of the camera's size.

    Raises:
        ConfigError: the scene has no camera.
        CalibrationError: the photograph's size is not the camera's.
    """
    sight = sight_of(scene, photo)
    still = torch.zeros(3, dtype=torch.float64)
    seen = outline_at(sight, still)
    if len(seen) < LEAST_EDGES or not float(seen.framed.double().mean()) >= LEAST_FRAMED:
        share = float(seen.framed.double().mean()) if len(seen) else 0.0
        return scene, left(None, 0, f"only {share:.0%} of its outline lie in the frame")
    first = matched(sight, still)
    pose, steps = voted(sight, seen), 0
    while steps < MAX_STEPS:
        change = normal_equations(matched(sight, pose)).change
        pose, steps = pose + change, steps + 1
        if float(reach_of(change)) < STILL or float(reach_of(pose)) > 2 * sight.reach:
            break
    return decided(sight, first, matched(sight, pose), steps)


def sight_of(scene: Scene, photo: LinearPhoto) -> Sight:
    """Returns what the search needs of a scene and its photograph."""
    check_seen(scene)
    if scene.camera is None:
        raise ConfigError("silhouette: the camera of this photograph is not known yet; see torchlight.observing.placed")
    height, width = photo.radiance.shape[-2:]
    if (width, height) != scene.camera.image_size:
        raise CalibrationError(
            f"the photograph has {width} x {height} pixels but camera.image_size says "
            f"{scene.camera.image_size[0]} x {scene.camera.image_size[1]}"
        )
    frame, pixel = pixel_frame(scene, scene.camera)
    corners = scene.triangles.reshape(-1, 3).double()
    extent = float((corners.amax(dim=0) - corners.amin(dim=0)).max())
    test = scene_occlusion(scene)
    contours = prepare(scene.triangles, LIFT / test.frame.scale)
    grey = photo.radiance.double().mean(dim=-3)
    seen = outline(contours, scene.camera, test)
    reach = TRUSTED * extent / pixel
    noise = slope_noise(grey, seen.pixels, seen.normals, reach) if len(seen) else 0.0
    return Sight(frame, scene.camera, contours, test, grey, noise, reach)


def pixel_frame(scene: Scene, camera: Camera) -> tuple[Frame, float]:
    """Returns the stated pose's frame in steps of a pixel, and how long a pixel is at the object."""
    frame = frame_of(scene)
    top = scene.triangles[..., 2].double().amax() / 2
    depth = float((torch.cat([frame.middle, top[None]]) - camera.position.double()).norm())
    pixel = depth / float(camera.intrinsics[[0, 1], [0, 1]].double().mean())
    per_turn = float(frame.unit[0] / frame.unit[2])  # the object's radius
    return replace(frame, unit=torch.tensor([pixel, pixel, pixel / per_turn], dtype=torch.float64)), pixel


def camera_at(sight: Sight, pose: Pose) -> Camera:
    """Returns the camera that sees the stated object as the scene's camera sees the moved one."""
    x, y, turn = (pose * sight.frame.unit).tolist()
    cosine, sine = math.cos(turn), math.sin(turn)
    motion = torch.eye(4, dtype=torch.float64)
    motion[:2, :2] = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
    motion[:2, 3] = sight.frame.middle - motion[:2, :2] @ sight.frame.middle
    motion[:2, 3] += torch.tensor([x, y], dtype=torch.float64)
    return replace(sight.camera, world_to_camera=sight.camera.world_to_camera.double() @ motion)


def outline_at(sight: Sight, pose: Pose) -> Outline:
    """Returns the outline of the moved object, its points as of the stated one."""
    return outline(sight.contours, camera_at(sight, pose), sight.test)


def rates_at(sight: Sight, pose: Pose, seen: Outline) -> Float[Tensor, "samples 3"]:
    """Returns how far the outline of the moved object moves per unit of its pose, in pixels."""
    x, y, turn = (pose * sight.frame.unit).tolist()
    cosine, sine = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    middle = torch.cat([sight.frame.middle, sight.frame.middle.new_zeros(1)])
    moved = (seen.points - middle) @ rotation.T + middle + torch.tensor([x, y, 0.0], dtype=torch.float64)
    here = sight.frame.middle + torch.tensor([x, y], dtype=torch.float64)
    return sensitivity(replace(seen, points=moved), sight.camera, here, sight.frame.unit)


def edges_at(sight: Sight, seen: Outline, reach: float) -> Found:
    """Returns the photograph's edges across an outline."""
    return edges_across(sight.grey, seen.pixels, seen.normals, reach, sight.noise)


def matched(sight: Sight, pose: Pose) -> Matched:
    """Returns the outline of a pose and the edge nearest to each of its samples."""
    seen = outline_at(sight, pose)
    offsets = edges_at(sight, seen, NEAR).offsets
    index = offsets.abs().nan_to_num(math.inf).argmin(dim=1, keepdim=True)
    nearest = offsets.gather(1, index)[:, 0]
    around = seen.pixels - seen.pixels.mean(dim=0)
    sector = ((torch.atan2(around[:, 1], around[:, 0]) / (2 * math.pi) + 0.5) * SECTORS).floor()
    nearest = torch.where(nearest.abs() <= NEAR, nearest, torch.nan)
    return Matched(pose, nearest, rates_at(sight, pose, seen), sector)


def voted(sight: Sight, seen: Outline) -> Pose:
    """Returns the pose of a grid around the stated one for which most of the outline has an edge."""
    offsets = edges_at(sight, seen, 2 * sight.reach).offsets
    rates = rates_at(sight, torch.zeros(3, dtype=torch.float64), seen)
    values, vectors = torch.linalg.eigh(rates.T @ rates / len(rates))
    axes = vectors[:, values > IMMOBILE**2]
    half, best = sight.reach, torch.zeros(axes.shape[1], dtype=torch.float64)
    while True:
        count = min(GRID, 2 * math.ceil(half) + 1)
        line = torch.linspace(-half, half, count, dtype=torch.float64)
        spacing = float(line[1] - line[0])
        grid = torch.stack(torch.meshgrid(*[line] * axes.shape[1], indexing="ij"), dim=-1).reshape(-1, axes.shape[1])
        poses = best + grid
        poses = poses[reach_of(poses @ axes.T) <= sight.reach]
        best = poses[votes(offsets, rates @ axes, poses, max(1.0, spacing)).argmax()]
        half = spacing
        if spacing <= 1.0:
            return axes @ best


def votes(
    offsets: Float[Tensor, "samples candidates"],
    rates: Float[Tensor, "samples axes"],
    poses: Float[Tensor, "poses axes"],
    width: float,
) -> Float[Tensor, " poses"]:
    """Returns the sum over samples of exp(-r^2 / 2 width^2), r the distance to the nearest edge."""
    known = offsets.nan_to_num(1e6)
    parts = []
    for part in poses.split(max(1, 4_000_000 // known.numel())):
        off = (part @ rates.T)[:, :, None] - known
        parts.append(torch.exp(-off.abs().amin(dim=-1).square() / (2 * width**2)).sum(dim=-1))
    return torch.cat(parts)


def decided(sight: Sight, first: Matched, last: Matched, steps: int) -> tuple[Scene, Placement]:
    """Returns the scene and the report: as found where it is believed, else as stated."""
    normal = normal_equations(last)
    refuse = partial(left, first.rms, steps)
    scene, unit = sight.frame.scene, scene_unit(sight)
    edges = int(last.offsets.isfinite().sum())
    if float(reach_of(last.pose)) > sight.reach:
        return scene, refuse(
            f"its outline fits best farther away than the trusted {sight.reach * unit:.2g} {scene.units}; "
            "check the scene file"
        )
    if edges < LEAST_EDGES or last.seen < LEAST_SEEN:
        return scene, refuse(f"too few edges along its outline ({last.seen:.0%} of it, {edges} samples)")
    if normal.axes.shape[1] == 0:
        return scene, refuse("its outline does not tell its place to within a pixel")
    along = normal.axes.T @ last.pose
    spread = normal.axes.T @ normal.covariance @ normal.axes
    believed = float(along @ torch.linalg.solve(spread, along)) > DOUBT**2
    deviation = deviations(sight, normal)
    if not believed:
        return scene, replace(refuse(f"no movement beyond {DOUBT:.0f} of its deviations"), deviation=deviation)
    if not last.cost <= (1 - SUFFICIENT) * first.cost:
        return scene, refuse(
            "no place brings its outline clearly nearer to edges; above a pixel of RMS its size or shape is wrong"
        )
    x, y, turn = (last.pose * sight.frame.unit).tolist()
    verdict = f"moved to where {last.seen:.0%} of its outline lie on edges ({first.seen:.0%} before),"
    if steps == MAX_STEPS and float(reach_of(normal.change)) > STILL:
        verdict = f"moved, and was not at rest after {MAX_STEPS} steps (check the scene file),"
    placement = Placement(
        by="silhouette",
        moved=(x, y),
        turned_degrees=math.degrees(turn),
        deviation=deviation,
        rms_before=first.rms,
        rms_after=last.rms,
        steps=steps,
        verdict=verdict,
    )
    return at(sight.frame, last.pose), placement


def scene_unit(sight: Sight) -> float:
    """Returns how long a pixel is at the object, in the scene's unit."""
    return float(sight.frame.unit[0])


def deviations(sight: Sight, normal: Normal) -> tuple[float | None, float | None, float | None]:
    """Returns the standard deviations of x, y and the turn in degrees; None of what is not known to a pixel."""
    pixels = normal.covariance.diagonal().sqrt()
    sizes = (pixels * sight.frame.unit * torch.tensor([1.0, 1.0, math.degrees(1.0)], dtype=torch.float64)).tolist()
    x, y, turn = (size if spread < 1 else None for size, spread in zip(sizes, pixels.tolist(), strict=True))
    return x, y, turn


def left(rms: float | None, steps: int, why: str) -> Placement:
    """Returns the report on an object that was left as stated."""
    return Placement("silhouette", (0.0, 0.0), 0.0, (None, None, None), rms, rms, steps, f"left as stated: {why}")
