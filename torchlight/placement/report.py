"""How far an object was moved from where the scene file has it, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

By = Literal["shadow", "silhouette"]
RESIDUALS = {"shadow": "of 255", "silhouette": "pixels"}


@dataclass(frozen=True)
class Placement:
    """How far the object was moved, and how sure that is.

    Attributes:
        by: what told.
        moved: in x and y, in the scene's unit.
        turned_degrees: counter-clockwise from above.
        deviation: standard deviations of these three; None where one is not determined.
        rms_before: residual at the stated pose, of the shadow in 255ths of the brightest sample (the channels' mean),
            of the silhouette in pixels; None where there is none.
        rms_after: where the object was left.
        steps: Gauss-Newton steps taken.
        verdict: what was decided and why, a clause.
    """

    by: By
    moved: tuple[float, float]
    turned_degrees: float
    deviation: tuple[float | None, float | None, float | None]
    rms_before: float | None
    rms_after: float | None
    steps: int
    verdict: str

    @property
    def changed(self) -> bool:
        """Whether the object is elsewhere than stated."""
        return self.moved != (0.0, 0.0) or self.turned_degrees != 0.0


def sentence(placement: Placement, units: str) -> str:
    """Returns what became of the object, in one line."""
    named = zip(("x", "y", "turn"), placement.deviation, (units, units, "degrees"), strict=True)
    known = ", ".join(f"{name} +- {size:.2g} {unit}" for name, size, unit in named if size is not None)
    x, y = placement.moved
    what = (
        f" by ({x:.4g}, {y:.4g}) {units}, turned by {placement.turned_degrees:.3g} degrees" if placement.changed else ""
    )
    parts = [f"the object was {placement.verdict}{what}", known]
    if placement.rms_before is not None and placement.rms_after is not None:
        parts.append(f"RMS {placement.rms_before:.2f} -> {placement.rms_after:.2f} {RESIDUALS[placement.by]}")
    return "; ".join(part for part in parts if part)
