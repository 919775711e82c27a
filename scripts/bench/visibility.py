"""How fast the plane's visibility is found without rays, against ray casters on the same work.

    python scripts/bench/visibility.py --data DIR [--out out/bench]

Samples on [-2, 2]^2 and random directions above 1 degree: 9,216 x 256 and 65,536 x 1,024, for a block, one of 1.8
times its size, a sphere of 81,920 faces, and the bunny and the chair of DIR/meshes. Prints millions of rays per second,
the best of several runs of each method on as many threads, how many times as fast the contours are, and how many
answers differ from Embree's: in all, and with no ray of Embree's within 1e-5 of the scene's size that agrees, which is
farther from a shadow's edge than that; writes OUT/visibility.csv. Mitsuba 3 (LLVM), Open3D and Warp (on the processor)
are asked where they can be imported. Preparation (welding, pairing, clusters; building a ray caster's tree) is not
counted, and printed apart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro
from jaxtyping import Bool, Float
from measuring import OUT, markdown, save
from torch import Tensor

from torchlight.geometry.contours import scene_contours
from torchlight.geometry.crossings import on_grid
from torchlight.geometry.plane_visibility import hidden_samples
from torchlight.geometry.receiver import Receiver, receiver_corners, receiver_points
from torchlight.geometry.scene import Scene
from torchlight.geometry.visibility import LIFT, occlusion_test
from torchlight.synthetic import Block, block_scene
from torchlight.threads import ordered_map, thread_count

SIZES = ((96, 256), (256, 1024))
LOWEST = math.sin(math.radians(1.0))
RUNS, LEAST_SECONDS = 3, 0.5  # a case takes some runs, and some time: a few milliseconds say little
ASKED = {  # ratios to Mitsuba
    **{(mesh, 96**2): ratio for mesh, ratio in (("block", 15.0), ("sphere", 2.0), ("bunny", 1.5), ("chair", 2.5))},
    **{(mesh, 256**2): ratio for mesh, ratio in (("block", 15.0), ("sphere", 8.0), ("bunny", 4.0), ("chair", 8.0))},
}
DIRECTIONS_PER_CALL = 64
NEAR = 1e-5  # of the scene's size: how near to a shadow's edge two methods may differ
TURNS = 8  # rays round one that stand for all as near as that
Method = Callable[[], Bool[np.ndarray, "directions points"]]


@dataclass(frozen=True)
class Row:
    """One method on one scene: its speed, its preparation and where it disagrees with Embree."""

    mesh: str
    faces: int
    samples: int
    directions: int
    hidden: float
    method: str
    prepared: float
    seconds: float
    different: int
    off_edges: int

    @property
    def speed(self) -> float:
        """Millions of rays per second."""
        return self.samples * self.directions / self.seconds / 1e6


def main(data: Path | None = None, out: Path = OUT) -> None:
    """Prints a Markdown table and writes OUT/visibility.csv.

    Args:
        data: folder that holds meshes/stanford-bunny.obj and meshes/chair_model.obj.
        out: where the CSV goes.
    """
    makers = {name: maker for name, maker in PEERS.items() if available(name)}
    rows = []
    for mesh, triangles in meshes(data).items():
        for side, count in SIZES:
            rows += measure(mesh, triangles, side, count, makers)
    shown = table(rows)
    print(markdown(shown))
    save("visibility", shown, thread_count(), out)


def meshes(data: Path | None) -> dict[str, Float[Tensor, "faces 3 3"]]:
    """Returns the occluders by name, standing on the plane, about 1.2 to 1.5 high but for a block that hides more."""
    block = block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (1, 1))).triangles
    sphere = torch.from_numpy(np.array(trimesh.creation.icosphere(subdivisions=6, radius=0.6).triangles))
    found = {
        "block": block,
        "large block": 1.8 * block,
        "sphere": sphere + torch.tensor([0.0, 0.0, 0.6]),
    }
    if data is None:
        print("no --data: the bunny and the chair are left out")
        return found
    for name, file in (("bunny", "stanford-bunny.obj"), ("chair", "chair_model.obj")):
        triangles = np.array(trimesh.load_mesh(data / "meshes" / file, process=False).triangles, dtype=np.float64)
        upright = np.stack([triangles[..., 0], -triangles[..., 2], triangles[..., 1]], axis=-1)
        low, high = upright.min(axis=(0, 1)), upright.max(axis=(0, 1))
        foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        found[name] = torch.from_numpy((upright - foot) * (1.5 / (high - low).max()))
    return found


def measure(
    mesh: str, triangles: Float[Tensor, "faces 3 3"], side: int, count: int, makers: dict[str, Callable[..., Method]]
) -> list[Row]:
    """Returns one row per method; Embree comes first, the others are compared with it."""
    scene = Scene(triangles, Receiver((0.0, 0.0), (4.0, 4.0), (side, side)))
    directions = upward(count)
    rows, expected = [], np.zeros(0)
    for name, make in makers.items():
        start = time.perf_counter()
        ask = make(scene, directions)
        prepared = time.perf_counter() - start
        found, seconds = best(ask)
        expected = found if not rows else expected
        different, share = found != expected, float(expected.mean())
        off = off_edges(scene, directions, found, different)
        wrong = int(different.sum())
        rows.append(Row(mesh, len(triangles), side**2, count, share, name, prepared, seconds, wrong, off))
    return rows


def off_edges(scene: Scene, directions: Float[Tensor, "directions 3"], found: np.ndarray, different: np.ndarray) -> int:
    """Returns how many different answers Embree gives for no ray within `NEAR` of the scene's size either."""
    test, points = occlusion_test(scene.triangles, receiver_corners(scene.receiver)), receiver_points(scene.receiver)
    number, point = different.nonzero()
    towards = directions.numpy()[number]
    side = np.cross(towards, np.roll(towards, 1, axis=1) + 0.1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    across, off = np.cross(towards, side), np.ones(len(number), dtype=bool)
    for turn in np.arange(TURNS) * (2 * math.pi / TURNS):
        moved = points[point] + NEAR / test.frame.scale * (math.cos(turn) * side + math.sin(turn) * across)
        off &= test.hidden(moved, towards) != found[number, point]
    return int(off.sum())


def upward(count: int) -> Float[Tensor, "directions 3"]:
    """Returns random unit directions, uniform in solid angle."""
    generator = torch.Generator().manual_seed(1)
    z = LOWEST + (1 - LOWEST) * torch.rand(count, generator=generator, dtype=torch.float64)
    azimuth = 2 * math.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], dim=1)


def best(ask: Method) -> tuple[Bool[np.ndarray, "directions points"], float]:
    """Returns the answer and the least time of a few runs after a first one, which compiles."""
    found, taken = ask(), []
    while len(taken) < RUNS or sum(taken) < LEAST_SECONDS:
        start = time.perf_counter()
        found = ask()
        taken.append(time.perf_counter() - start)
    return found, min(taken)


def by_embree(scene: Scene, directions: Float[Tensor, "directions 3"]) -> Method:
    """Embree through embreex, a thread pool over one scene."""
    test, points = occlusion_test(scene.triangles, receiver_corners(scene.receiver)), receiver_points(scene.receiver)
    parts, still = directions.numpy(), np.zeros((len(directions), 2))

    def some(start: int) -> np.ndarray:
        part = slice(start, start + DIRECTIONS_PER_CALL)
        return test.hidden_on_plane(points, parts[part], still[part])

    return lambda: np.concatenate(list(ordered_map(some, range(0, len(parts), DIRECTIONS_PER_CALL))))


def by_contours(scene: Scene, directions: Float[Tensor, "directions 3"]) -> Method:
    """Signed contour crossings."""
    shape = on_grid(scene_contours(scene), scene.receiver, lines=1)
    return lambda: hidden_samples(shape, directions).numpy()


def rays(scene: Scene, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns origins and directions, float32, [directions x points, 3]."""
    points = receiver_points(scene.receiver) + np.array([0.0, 0.0, 4.0 * LIFT])
    return np.tile(points, (len(part), 1)).astype(np.float32), np.repeat(part, len(points), axis=0).astype(np.float32)


def by_mitsuba(scene: Scene, directions: Float[Tensor, "directions 3"]) -> Method:
    """Mitsuba 3 `ray_test` in its LLVM variant, all of its threads."""
    drjit, mitsuba = import_module("drjit"), import_module("mitsuba")
    mesh = mitsuba.Mesh("occluder", 3 * len(scene.triangles), len(scene.triangles))
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = scene.triangles.float().reshape(-1).numpy()
    parameters["faces"] = np.arange(3 * len(scene.triangles), dtype=np.uint32)
    parameters.update()
    loaded = mitsuba.load_dict({"type": "scene", "occluder": mesh})
    points, count = receiver_points(scene.receiver), scene.receiver.points
    places = [mitsuba.Float(points[:, k].astype(np.float32)) for k in range(2)]

    def some(part: np.ndarray) -> np.ndarray:
        index = drjit.arange(mitsuba.UInt32, count * len(part))
        sample, number = index % count, index // count
        origin = mitsuba.Point3f(*(drjit.gather(mitsuba.Float, place, sample) for place in places), 4.0 * LIFT)
        axes = [mitsuba.Float(part[:, k].astype(np.float32)) for k in range(3)]
        towards = mitsuba.Vector3f(*(drjit.gather(mitsuba.Float, axis, number) for axis in axes))
        return np.array(loaded.ray_test(mitsuba.Ray3f(origin, towards))).reshape(len(part), count)

    step = max(1, 2**24 // count)
    return lambda: np.concatenate([some(directions[k : k + step].numpy()) for k in range(0, len(directions), step)])


def by_open3d(scene: Scene, directions: Float[Tensor, "directions 3"]) -> Method:
    """Open3D's RaycastingScene."""
    caster = import_module("open3d").t.geometry.RaycastingScene()
    corners = scene.triangles.float().reshape(-1, 3).numpy()
    caster.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))

    def some(part: np.ndarray) -> np.ndarray:
        origins, towards = rays(scene, part)
        return caster.test_occlusions(np.concatenate([origins, towards], axis=1)).numpy().reshape(len(part), -1)

    return lambda: np.concatenate([some(part.numpy()) for part in directions.split(DIRECTIONS_PER_CALL)])


def by_warp(scene: Scene, directions: Float[Tensor, "directions 3"]) -> Method:
    """Warp's mesh queries on the processor: each launch runs on one thread, so a thread pool over one mesh."""
    warp = import_module("warp")
    corners = scene.triangles.float().reshape(-1, 3).numpy()
    mesh = warp.Mesh(
        points=warp.array(corners, dtype=warp.vec3, device="cpu"),
        indices=warp.array(np.arange(len(corners), dtype=np.int32), dtype=warp.int32, device="cpu"),
    )
    kernel = import_module("warp_rays").any_hit
    points = receiver_points(scene.receiver) + np.array([0.0, 0.0, 4.0 * LIFT])
    origins = warp.array(points.astype(np.float32), dtype=warp.vec3, device="cpu")
    towards = warp.array(directions.numpy().astype(np.float32), dtype=warp.vec3, device="cpu")

    def some(start: int) -> np.ndarray:
        part = towards[start : start + DIRECTIONS_PER_CALL]
        result = warp.zeros((len(part), len(points)), dtype=warp.uint8, device="cpu")
        warp.launch(kernel, dim=result.shape, inputs=[mesh.id, origins, part, result], device="cpu")
        return result.numpy().view(bool)

    return lambda: np.concatenate(list(ordered_map(some, range(0, len(directions), DIRECTIONS_PER_CALL))))


CONTOURS = "contours"
PEERS = {"embreex": by_embree, CONTOURS: by_contours, "Mitsuba LLVM": by_mitsuba, "Open3D": by_open3d, "Warp": by_warp}


def available(name: str) -> bool:
    """Returns whether a method can be imported here; says so where it cannot."""
    try:
        if name == "Mitsuba LLVM":
            mitsuba = import_module("mitsuba")
            mitsuba.set_variant("llvm_ad_rgb")
            drjit = import_module("drjit")
            drjit.eval(mitsuba.Float([1.0]) + 1.0)
        if name == "Open3D":
            import_module("open3d")
        if name == "Warp":
            import_module("warp").config.quiet = True
            import_module("warp").init()
    except Exception as error:  # noqa: BLE001  (whatever keeps a peer from running is told)
        print(f"{name} is left out: {str(error).splitlines()[0]}")
        return False
    return True


def table(rows: list[Row]) -> list[dict[str, object]]:
    """Returns the rows of the table: of a peer, with how many times as fast the contours are."""
    ours = {(r.mesh, r.samples): r.speed for r in rows if r.method == CONTOURS}
    return [told(r, ours[r.mesh, r.samples] / r.speed) for r in rows]


def told(row: Row, ratio: float) -> dict[str, object]:
    """Returns one row of the table."""
    size = f"{row.samples:,} x {row.directions:,}"
    peer = row.method != CONTOURS
    against = ASKED.get((row.mesh, row.samples)) if row.method == "Mitsuba LLVM" else None
    return {
        "case": f"visibility, {row.mesh}, {size}",
        "faces": row.faces,
        "hidden": f"{row.hidden:.1%}",
        "peer": row.method if peer else None,
        "million rays per second": row.speed,
        "ratio": ratio if peer else None,
        "asked": against,
        "preparation, seconds": row.prepared,
        "differ from Embree": row.different,
        "farther than 1e-5 from an edge": row.off_edges,
    }


if __name__ == "__main__":
    tyro.cli(main)
