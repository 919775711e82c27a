"""Light as spherical harmonic coefficients, in a JSON file that says what its numbers mean."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.io import fields
from torchlight.io.atomic import write_atomically
from torchlight.io.fields import Field
from torchlight.io.planes import plane_of
from torchlight.light.grids import LatlongGrid
from torchlight.light.primaries import PRIMARIES, check_primaries, convert_primaries
from torchlight.light.projection import MAX_DEGREE, check_degree, cosine_factors, expand, project
from torchlight.light.sampled import SampledLight, to_environment

FORMAT = "spherical harmonics"
STATED = {  # what never differs, written for the reader's sake
    "format": FORMAT,
    "index": "l (l + 1) + m for l = 0 .. degree, m = -l .. l",
    "basis": "real, orthonormal over the sphere, without the Condon-Shortley phase; cos m phi at m > 0, sin |m| phi at "
    "m < 0",
    "axes": "right-handed, Z up; theta from +Z, phi = atan2(y, x)",
}
COLOURS = ("red", "green", "blue")
_KEYS = (*STATED, "degree", "cosine_convolved", "quantity", "units", "primaries", "light_plane", "metadata", *COLOURS)
_QUANTITY = {False: "radiance L = sum of c Y", True: "irradiance E(n) = sum of c Y(n), c already times A_l"}
_ROWS_PER_DEGREE, _MINIMUM_ROWS = 16, 64  # then averages over pixels keep the highest degree to 0.2 %


def write_coefficients(
    path: str | Path,
    light: SampledLight,
    degree: int,
    metadata: Mapping[str, Any],
    *,
    cosine_convolved: bool = False,
    primaries: str = "rec709",
) -> None:
    """Writes the coefficients of light up to a degree.

    Args:
        path: destination.
        light: on any grid; one that is no lat-long is taken through one.
        degree: largest l.
        metadata: anything JSON can hold.
        cosine_convolved: of irradiance by normal, each coefficient times A_l = pi, 2 pi / 3, pi / 4, 0, ...
        primaries: one of `light.primaries.PRIMARIES`, which colours are converted to.

    Raises:
        ConfigError: a degree outside 0 .. 64, or unknown primaries.
        FormatError: the file cannot be written.
    """
    check_degree(degree)
    check_primaries(primaries)
    values = project(to_environment(light).radiance.double(), degree)
    values = convert_primaries(values, PRIMARIES["rec709"], PRIMARIES[primaries])
    if cosine_convolved:
        values = values * cosine_factors(degree)
    content = {
        **STATED,
        "degree": degree,
        "cosine_convolved": cosine_convolved,
        "quantity": _QUANTITY[cosine_convolved],
        "units": light.units,
        "primaries": primaries,
        "light_plane": None if light.plane is None else asdict(light.plane),
        "metadata": dict(metadata),
        **dict(zip(COLOURS, values.tolist(), strict=True)),
    }
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def decode_coefficients(data: bytes, name: str) -> SampledLight:
    """Returns the light of a file that `write_coefficients` wrote, as a lat-long: what the sum of c Y is.

    Of irradiance, the odd degrees above 1 are lost (A_l = 0) and taken as 0.

    Raises:
        FormatError: not such a file, a number is missing, or not finite.
    """
    try:
        root = Field(json.loads(data), Path(name), "")
        content = fields.mapping(root, _KEYS)
        if "format" not in content or content["format"].value != FORMAT:
            root.fail(f'expected "format": "{FORMAT}"; no other JSON is light')
        degree = fields.integers(Field([_required(content, "degree", root).value], root.file, "degree"), 1)[0]
        if not 0 <= degree <= MAX_DEGREE:
            content["degree"].fail(f"expected 0 to {MAX_DEGREE}")
        values = _values(content, root, degree)
        units = fields.text(content["units"]) if "units" in content else "relative"
        plane = plane_of(content["light_plane"].value if "light_plane" in content else None)
    except (ValueError, RecursionError, TorchlightError) as error:
        message = str(error) if isinstance(error, TorchlightError) else f"{name}: not JSON"
        raise FormatError(message if message.startswith(name) else f"{name}: {message}") from error
    height = max(_MINIMUM_ROWS, _ROWS_PER_DEGREE * (degree + 1))
    radiance = expand(values, height).float().flatten(start_dim=1)
    return SampledLight(radiance, LatlongGrid(height), not bool((radiance < 0).any()), units, plane)


def _values(content: dict[str, Field], root: Field, degree: int) -> Float[Tensor, "3 coeffs"]:
    """Returns the coefficients of radiance in Rec.709."""
    rows = [fields.numbers(_required(content, colour, root), (degree + 1) ** 2) for colour in COLOURS]
    values = torch.tensor(rows, dtype=torch.float64)
    primaries = fields.choice(content["primaries"], tuple(PRIMARIES)) if "primaries" in content else "rec709"
    values = convert_primaries(values, PRIMARIES[primaries], PRIMARIES["rec709"])
    convolved = _required(content, "cosine_convolved", root)
    if not isinstance(convolved.value, bool):
        convolved.wrong_type("true or false")
    if not convolved.value:
        return values
    factors = cosine_factors(degree)
    return torch.where(factors == 0, 0, values / torch.where(factors == 0, 1, factors))


def _required(content: dict[str, Field], key: str, root: Field) -> Field:
    if key not in content:
        raise ConfigError(root.describe(f"{key} is missing; write the file again"))
    return content[key]
