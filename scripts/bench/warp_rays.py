"""A ray for every sample and direction, as Warp compiles it. Only scripts/bench/visibility.py imports it.

Warp reads a kernel's annotations as its types, so none is deferred here.
"""

import warp as wp  # pyright: ignore[reportMissingImports]

FAR = 1.0e6


@wp.kernel
def any_hit(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),  # pyright: ignore[reportInvalidTypeForm]
    directions: wp.array(dtype=wp.vec3),  # pyright: ignore[reportInvalidTypeForm]
    result: wp.array2d(dtype=wp.uint8),  # pyright: ignore[reportInvalidTypeForm]
) -> None:
    """Writes 1 where a ray meets the mesh."""
    number, point = wp.tid()
    if wp.mesh_query_ray_anyhit(mesh, origins[point], directions[number], FAR):
        result[number, point] = wp.uint8(1)
