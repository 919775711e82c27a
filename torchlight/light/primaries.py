"""RGB primaries: linear colours of one set in another, by matrices derived from chromaticities.

A set is eight numbers, x and y of red, green, blue and white (CIE 1931). With P the XYZ of the primaries, scaled so
that their sum is the white, RGB of set a becomes RGB of set b by

    P_b^-1  B^-1 diag(B w_b / B w_a) B  P_a,

with Bradford's cone responses B: white stays white. Rec.709 (D65) to ACEScg (AP1, about D60) then is the matrix that
ACES publishes. A colour outside the new set's triangle gets a negative component; nothing is clipped here.

References:
    SMPTE RP 177 (1993). Lam (1985), Metamerism and colour constancy, and CIE 160 (2004) for Bradford's matrix.
    Academy S-2014-004 (ACEScg), ST 2065-1 (2012), ITU-R BT.709-6 (2015) and BT.2020-2 (2015) for the primaries.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError

Chromaticities = tuple[float, ...]
_D65, _ACES_WHITE = (0.3127, 0.3290), (0.32168, 0.33767)
PRIMARIES: dict[str, Chromaticities] = {
    "rec709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *_D65),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    "acescg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES_WHITE),
    "aces2065-1": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, *_ACES_WHITE),
}
DUST = 1e-6
SAME = 2e-3  # files hold float32, and some programs round to three digits


def check_primaries(name: str) -> None:
    """Raises ConfigError unless the name is one of `PRIMARIES`."""
    if name not in PRIMARIES:
        raise ConfigError(f"primaries: unknown name {name!r}; choose one of {', '.join(PRIMARIES)}")


def named(chromaticities: Sequence[float]) -> str | None:
    """Returns the name of a set of primaries, up to what files round away; None for a set without one."""
    for name, known in PRIMARIES.items():
        if all(abs(a - b) <= SAME for a, b in zip(chromaticities, known, strict=True)):
            return name
    return None


def rgb_to_xyz(chromaticities: Sequence[float]) -> Float[Tensor, "3 3"]:
    """Returns the matrix from linear RGB of a set to CIE XYZ, white at Y = 1, float64.

    Raises:
        ConfigError: not eight finite numbers, or primaries on one line.
    """
    if len(chromaticities) != 8 or not all(math.isfinite(value) for value in chromaticities):
        raise ConfigError("primaries: expected eight finite numbers: x and y of red, green, blue and white")
    points = torch.tensor(list(chromaticities), dtype=torch.float64).reshape(4, 2)
    xyz = torch.cat([points, 1 - points.sum(dim=1, keepdim=True)], dim=1).T  # columns: red, green, blue, white
    if not abs(torch.linalg.det(xyz[:, :3]).item()) > 1e-6 or not abs(points[3, 1].item()) > 1e-6:
        raise ConfigError("primaries: red, green and blue lie on one line, or white is no light; state others")
    white = xyz[:, 3] / points[3, 1]
    return xyz[:, :3] * torch.linalg.solve(xyz[:, :3], white)


def conversion(source: Sequence[float], target: Sequence[float]) -> Float[Tensor, "3 3"]:
    """Returns the matrix from linear RGB of one set of primaries to another's, white to white, float64."""
    into, out_of = rgb_to_xyz(source), rgb_to_xyz(target)
    bradford = _bradford()
    whites = [bradford @ matrix.sum(dim=1) for matrix in (into, out_of)]
    adaptation = torch.linalg.solve(bradford, (whites[1] / whites[0])[:, None] * bradford)
    return torch.linalg.solve(out_of, adaptation @ into)


def convert_primaries(
    rgb: Float[Tensor, "*batch channels=3 samples"], source: Sequence[float], target: Sequence[float]
) -> Float[Tensor, "*batch channels=3 samples"]:
    """Returns colours of one set of primaries in another, per sample; the same values where the sets are the same.

    A component below 0 by less than 1e-6 of the largest is 0: a pure red that went there and back in float32 is red.
    """
    if tuple(source) == tuple(target):
        return rgb
    values = conversion(source, target).to(rgb.device) @ rgb.double()
    dust = (values < 0) & (values.abs() <= DUST * values.abs().amax(dim=-2, keepdim=True))
    return torch.where(dust, 0, values).to(rgb.dtype)


def _bradford() -> Float[Tensor, "3 3"]:
    rows = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
    return torch.tensor(rows, dtype=torch.float64)
