"""How cost grows with samples, texels, faces and photographs, and how far each kernel is from what the machine can do.

    python scripts/bench/growth.py [--out out/bench]

One axis at a time: a transport (a sphere on the plane, 192 directions along a cube edge), and non-negative least
squares of RGB photographs of a block under the built-in sky, turned. Then the ceilings of the machine, measured by a
product of matrices and by a copy, and what share of them the pieces of a solve and of a transport reach: operations and
bytes are counted, not measured. Prints Markdown tables and writes OUT/growth.csv and OUT/roofline.csv. Seconds are the
least of three runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch
import tyro
from measuring import OUT, Row, best, markdown, peak_gib, save
from photographs import photographs, scene
from transport import exponent, met, receiver, sphere

from torchlight.geometry.scene import Scene
from torchlight.relighting import irradiance
from torchlight.solvers import NNLS, LeastSquares
from torchlight.solvers.modulus import modulus_of
from torchlight.solvers.shared_gram import unit_gram
from torchlight.threads import thread_count
from torchlight.transfer import transport

RUNS = 3
EDGE = 192  # directions along a cube face's edge
USUAL = {"samples": 64, "texels": 16, "faces": 4, "photographs": 64}  # sides, texels along an edge, divisions, count
SIDES = (32, 64, 128, 256)
RESOLUTIONS = (8, 16, 32, 64)
DIVISIONS = (3, 4, 5, 6)
COUNTS = (16, 64, 256, 1024)
SOLVED_RESOLUTIONS = (8, 16, 32)
GIB = 2**30
SORTED_BYTES = 32  # of a crossing of 8 bytes: written, read, and moved once by the sort


def main(out: Path = OUT, only_roofline: bool = False) -> None:
    """Prints Markdown tables and writes OUT/growth.csv and OUT/roofline.csv.

    Args:
        out: where the CSV files go.
        only_roofline: not the growth, which takes two minutes.
    """
    if not only_roofline:
        grown(out)
    pieces = list(rooflines())
    print(f"\n{markdown(pieces)}")
    save("roofline", pieces, thread_count(), out)


def grown(out: Path) -> None:
    """Prints and writes the cost along each axis."""
    rows = [*transports(), *solves()]
    for what, axis in dict.fromkeys((str(row["what"]), str(row["axis"])) for row in rows):
        some = [row for row in rows if (row["what"], row["axis"]) == (what, axis)]
        sizes, seconds = ([float(str(row[key])) for row in some] for key in ("size", "seconds"))
        print(f"\n{what}: seconds grow as {axis} to the power {exponent(sizes, seconds):.2f}\n\n{markdown(some)}")
    save("growth", rows, thread_count(), out)


def transports() -> Iterator[Row]:
    """Yields the cost of a sphere's transport along samples, texels and faces."""
    for side in SIDES:
        yield transported("samples", side**2, USUAL["faces"], side, USUAL["texels"])
    for resolution in RESOLUTIONS:
        yield transported("texels", 3 * resolution**2, USUAL["faces"], USUAL["samples"], resolution)
    for divisions in DIVISIONS:
        yield transported("faces", 20 * 4**divisions, divisions, USUAL["samples"], USUAL["texels"])


def transported(axis: str, size: int, divisions: int, side: int, resolution: int) -> Row:
    """Returns the cost of one transport."""
    ball = Scene(sphere(divisions), receiver(side))
    _, cost = best(lambda: transport(ball, resolution, EDGE // resolution), RUNS)
    return row("transport", axis, size, cost.wall, cost.processor)


def solves() -> Iterator[Row]:
    """Yields the cost of exact solves along samples, texels and photographs."""
    for side in SIDES[:-1]:
        yield solved("samples", side**2, side, USUAL["texels"], USUAL["photographs"])
    for resolution in SOLVED_RESOLUTIONS:
        yield solved("texels", 3 * resolution**2, USUAL["samples"], resolution, USUAL["photographs"])
    for count in COUNTS:
        yield solved("photographs", count, USUAL["samples"], USUAL["texels"], count)


def solved(axis: str, size: int, side: int, resolution: int, count: int) -> Row:
    """Returns the cost of the exact light of some photographs, the Gram matrix included."""
    problem = problem_of(side, resolution, count)
    _, cost = best(lambda: NNLS().solve(problem), RUNS if count < 1000 else 1)
    return row("non-negative solve", axis, size, cost.wall, cost.processor)


def problem_of(side: int, resolution: int, count: int) -> LeastSquares:
    """Returns photographs of a block and the transport that explains them."""
    where = scene(side)
    shown = photographs(where, min(count, 64), None)
    again = -(-count // 64)
    samples = shown.samples.repeat(again, 1, 1)[:count]
    matrix = transport(where, resolution, EDGE // resolution).transport.double()
    return LeastSquares(matrix, samples.double(), shown.weights[:1].double().expand(count, -1))


def row(what: str, axis: str, size: int, wall: float, processor: float) -> Row:
    """Returns a line of growth.csv."""
    return {
        "what": what,
        "axis": axis,
        "size": size,
        "seconds": wall,
        "processor seconds": processor,
        "peak memory so far, GiB": peak_gib(),
    }


# --- ceilings --------------------------------------------------------------------------------------------------------


def rooflines() -> Iterator[Row]:
    """Yields the machine's ceilings, and what pieces of a solve and of a transport reach of them."""
    single, double, moved = product_rate(torch.float32), product_rate(torch.float64), copy_rate()
    yield {"what": "ceiling: product, float32", "GFLOP/s": single}
    yield {"what": "ceiling: product, float64", "GFLOP/s": double}
    yield {"what": "ceiling: copy", "GB/s": moved}
    yield from pieces_of_a_solve(single, double)
    yield from pieces_of_a_transport(moved)


def product_rate(kind: torch.dtype, size: int = 3072) -> float:
    """Returns 10^9 operations a second of a product of square matrices."""
    matrix = torch.rand(size, size, dtype=kind)
    _, cost = best(lambda: matrix @ matrix, RUNS)
    return 2 * size**3 / cost.wall / 1e9


def copy_rate(size: int = GIB) -> float:
    """Returns 10^9 bytes a second, read and written, of a copy."""
    source = torch.zeros(size // 8, dtype=torch.float64)
    target = torch.empty_like(source)
    _, cost = best(lambda: target.copy_(source), RUNS)
    return 2 * size / cost.wall / 1e9


def pieces_of_a_solve(single: float, double: float) -> Iterator[Row]:
    """Yields the pieces of the solve of 256 photographs: products, guesses, and the exact minimisers that remain."""
    problem = problem_of(USUAL["samples"], USUAL["texels"], 256)
    columns, samples = problem.matrix, problem.samples.flatten(0, 1)
    points, n = columns.shape
    items = samples.shape[0]
    gram, cost = best(lambda: columns.T @ columns, RUNS)
    yield reached("Gram matrix", 2 * points * n**2, cost.wall, double)
    correlations, cost = best(lambda: samples @ columns, RUNS)
    spent = cost.wall
    yield reached("A'b of 768 channels", 2 * points * n * items, cost.wall, double)
    base = unit_gram(gram)
    guess = modulus_of(base.gram)
    _, cost = best(lambda: guess.minimizers(correlations * base.inverse), RUNS)
    spent += cost.wall
    yield reached("guessed supports", 2 * sum(steps for _, steps in guess.stages) * n**2 * items, cost.wall, single)
    found, cost = best(lambda: NNLS().solve(problem), RUNS)
    used = (found.coefficients > 0).sum(dim=-1).double()
    operations = float((found.steps.double() * (used**3 / 3 + 2 * used * n)).sum())
    yield reached("exact minimisers, and certificates", operations, cost.wall - spent, double)
    _, cost = best(lambda: irradiance(columns, found.coefficients), RUNS)
    yield reached("irradiance of 768 channels", 2 * points * n * items, cost.wall, double)


def reached(what: str, operations: float, seconds: float, ceiling: float) -> Row:
    """Returns a line for a piece that computes."""
    rate = operations / seconds / 1e9
    return {
        "what": what,
        "GFLOP": operations / 1e9,
        "seconds": seconds,
        "GFLOP/s": rate,
        "of the ceiling": rate / ceiling,
    }


def pieces_of_a_transport(moved: float) -> Iterator[Row]:
    """Yields two transports: one that crosses many contours, one that is mostly its own result."""
    yield carried("transport, sphere of 81,920 faces", Scene(sphere(6), receiver(64)), 16, moved)
    yield carried("transport, 65,536 samples", Scene(sphere(3), receiver(256)), 32, moved)


def carried(what: str, ball: Scene, resolution: int, moved: float) -> Row:
    """Returns a line for a transport: its crossings are written and sorted, its result written and read."""
    crossings = met(ball, resolution, EDGE // resolution) * 1e6
    _, cost = best(lambda: transport(ball, resolution, EDGE // resolution), RUNS)
    total = SORTED_BYTES * crossings + 3 * 4.0 * ball.receiver.points * 3 * resolution**2
    rate = total / cost.wall / 1e9
    return {
        "what": what,
        "GB": total / 1e9,
        "seconds": cost.wall,
        "GB/s": rate,
        "of the ceiling": rate / moved,
        "ns per crossing": 1e9 * cost.processor / crossings,
    }


if __name__ == "__main__":
    tyro.cli(main)
