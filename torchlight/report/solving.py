"""How a light was found and where it comes from, in tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from torchlight.report.markup import grid


def solve_numbers(result: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields how the light was found and how that ended."""
    yield "Method", f"{result['method']}, {result['resolution']} texels along a cube edge, solver {result['solver']}"
    if result["functions"]:
        yield "Functions in use", f"{', '.join(map(str, result['functions']))} (red, green, blue)"
    yield "Not zero", f"{', '.join(map(str, result['nonzero']))} of {result['coefficients']} coefficients"
    yield "Solver ended", f"{', '.join(result['status'])} after {', '.join(map(str, result['steps']))} steps"
    yield "Certificates", f"KKT residual {scientific(result['kkt_residual'])}; gap {scientific(result['gap'])}"


def scientific(values: Sequence[float | None]) -> str:
    """Returns numbers with their powers of ten."""
    return ", ".join("-" if value is None else f"{value:.1e}" for value in values)


def peaks(result: Mapping[str, Any]) -> str:
    """Returns a table of the strongest sources."""
    if result["peak_direction"] is None:
        return ""
    first = {"direction": result["peak_direction"], "share": result["peak_share"]}
    rows = [
        (f"{azimuth:.1f}", f"{elevation:.1f}", f"{peak['share']:.1%}")
        for peak in (first, *result["peaks"])
        for azimuth, elevation in [angles(peak["direction"])]
    ]
    head = ("azimuth from +x [degrees]", "elevation [degrees]", "share of the light on the plane")
    return grid("Strongest sources", head, rows)


def angles(direction: Sequence[float]) -> tuple[float, float]:
    """Returns azimuth (from +x towards +y) and elevation in degrees."""
    x, y, z = direction
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))
