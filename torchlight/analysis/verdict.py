"""What the analysis means, in words: how fine, how much, where it is blind, and when too much is asked for."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.analysis.nullity import Nullity, equations, nullity
from torchlight.analysis.observability import Observability, degrees_of_freedom, texel_solid_angles, whitened
from torchlight.analysis.sampling import random_rotations
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.light.bases import Basis, SphericalHarmonics
from torchlight.light.directions import to_angles
from torchlight.transfer import Transfer

BLIND = 0.1  # R_ii below which a texel counts as blind: nine tenths of the answer are the prior's
SECTORS = 24  # of azimuth, 15 degrees each
BANDS = 18  # of elevation, 5 degrees each
MOSTLY_BAND = 2 / 3  # share of a band's solid angle: a blind half of the azimuths is no matter of elevation
MOSTLY_SECTOR = 1 / 2
EVERYWHERE, NOWHERE = 0.98, 0.01
WARNING_NOISE = 0.01
WARNING_ROTATIONS = 100
LARGEST_CHECKED = 12  # bandwidth: larger ones are judged by this one


def verdict(curve: Nullity, seen: Observability, camera_azimuth: float | None, noise: float) -> list[str]:
    """Returns three plain lines: the recommended bandwidth, what is determined at 16 x 16, where the scene is blind.

    Args:
        curve: nullity of the samples that are used.
        seen: observability of the same samples.
        camera_azimuth: direction of the camera seen from the receiver's middle, in radians; None without a camera.
        noise: the noise that `seen` was made with.
    """
    bandwidth = curve.recommended()
    n = seen.resolution
    frequency = (
        f"up to B = {bandwidth} ({bandwidth**2} coefficient{'s' if bandwidth > 1 else ''})"
        if bandwidth
        else "not even a constant light (B = 1)"
    )
    return [
        f"harmonics: {frequency}",
        f"detail: {seen.share(seen.determined):.0%} of the upper hemisphere determined at {n}x{n}, "
        f"{seen.degrees_of_freedom:.0f} of {len(seen.diagonal)} degrees of freedom at {100 * noise:.3g} % noise",
        f"blind: {blind_words(seen, camera_azimuth)}",
    ]


def blind(seen: Observability) -> Bool[Tensor, " texels"]:
    """Returns the texels of which the photographs say next to nothing: R_ii < 0.1."""
    return seen.diagonal < BLIND


def blind_words(seen: Observability, camera_azimuth: float | None = None) -> str:
    """Returns the blind directions in words.

    They are an elevation below which most are blind, one above which most are, and ranges of azimuth between. "Most"
    is two thirds of a band of 5 degrees of elevation, half of a sector of 15 degrees of azimuth. A range of azimuth on
    the camera's side is said to be so: its shadows fall behind the object, where the camera does not look.
    """
    texels = blind(seen)
    total = seen.share(texels)
    if total >= EVERYWHERE:
        return "everywhere"
    if total < NOWHERE:
        return "nowhere"
    theta, azimuth = to_angles(cubemap.texel_directions(seen.resolution, 5)[cubemap.visible_texels(seen.resolution)])
    elevation = math.pi / 2 - theta
    angles = texel_solid_angles(seen.resolution)
    horizon, ceiling = _limits(elevation, angles, texels)
    between = (elevation > horizon) & (elevation < ceiling)
    ranges = _ranges(_blind_sectors(azimuth[between], angles[between], texels[between]))
    parts = [f"below {math.degrees(horizon):.0f} degrees of elevation"] if horizon > 0 else []
    parts += [_range_words(first, last, camera_azimuth) for first, last in ranges]
    parts += [f"above {math.degrees(ceiling):.0f} degrees of elevation"] if ceiling < math.pi / 2 else []
    return f"{'; '.join(parts) or 'scattered directions'} ({total:.0%} of the upper hemisphere)"


def _limits(
    elevation: Float[Tensor, " texels"], angles: Float[Tensor, " texels"], texels: Bool[Tensor, " texels"]
) -> tuple[float, float]:
    """Returns the elevations below and above which every band is mostly blind, in radians; 0 and pi/2 if all are."""
    step = math.pi / 2 / BANDS
    band = (elevation / step).long().clamp(0, BANDS - 1)
    mostly = (_blind_share(band, BANDS, angles, texels) > MOSTLY_BAND).long()
    mostly[-1] |= mostly[-2]  # no texel's centre need lie within 5 degrees of the zenith
    if bool(mostly.all()):
        return 0.0, math.pi / 2
    low, high = mostly.cumprod(dim=0).sum(), mostly.flip(0).cumprod(dim=0).sum()
    return step * int(low.item()), step * (BANDS - int(high.item()))


def _blind_sectors(
    azimuth: Float[Tensor, " texels"], angles: Float[Tensor, " texels"], texels: Bool[Tensor, " texels"]
) -> list[bool]:
    """Returns which sectors of azimuth, from -pi on, are mostly blind."""
    sector = ((azimuth + math.pi) / (2 * math.pi) * SECTORS).long().clamp(0, SECTORS - 1)
    return (_blind_share(sector, SECTORS, angles, texels) > MOSTLY_SECTOR).tolist()


def _blind_share(
    bins: Int[Tensor, " texels"], count: int, angles: Float[Tensor, " texels"], texels: Bool[Tensor, " texels"]
) -> Float[Tensor, " bins"]:
    """Returns the share of each bin's solid angle that some texels cover; 0 for an empty bin."""
    whole = angles.new_zeros(count).index_add_(0, bins, angles)
    part = angles.new_zeros(count).index_add_(0, bins, angles * texels)
    return part / torch.where(whole > 0, whole, 1.0)


def _ranges(flags: list[bool]) -> list[tuple[int, int]]:
    """Returns the runs of True of a closed ring as (first, one past the last); the last may exceed the ring."""
    count = len(flags)
    if all(flags):
        return [(0, count)]
    starts = [i for i in range(count) if flags[i] and not flags[i - 1]]
    return [(i, next(j for j in range(i + 1, i + count) if not flags[j % count])) for i in starts]


def _range_words(first: int, last: int, camera_azimuth: float | None) -> str:
    if last - first >= SECTORS:
        return "all azimuths"
    step = 360 // SECTORS
    start, end = -180 + first * step, -180 + last * step
    middle = math.radians((start + end) / 2)
    side = ""
    if camera_azimuth is not None and math.cos(middle - camera_azimuth) > math.cos(math.pi / 4):
        side = " (light from the camera's side: its shadows fall behind the object)"
    return f"azimuth {_wrapped(start)} to {_wrapped(end)} degrees{side}"


def _wrapped(degrees: int) -> int:
    return (degrees + 180) % 360 - 180


def camera_azimuth(scene: Scene) -> float | None:
    """Returns the azimuth of the camera seen from the receiver's middle, in radians.

    None without a camera, and for one that looks from within 30 degrees of the normal.
    """
    if scene.camera is None:
        return None
    x, y, z = scene.camera.position.tolist()
    x, y = x - scene.receiver.center[0], y - scene.receiver.center[1]
    return math.atan2(y, x) if math.hypot(x, y) > z * math.tan(math.pi / 6) else None


def excess(transfer: Transfer, visible: Bool[Tensor, " points"], basis: Basis, nonnegative: bool) -> str | None:
    """Returns one line where more is asked for than the scene can determine, None otherwise.

    - Where the solver keeps radiance non-negative, which the linear analysis does not know of, only counting is
      certain: more coefficients than samples.
    - Spherical harmonics without that constraint: a bandwidth beyond the recommended one.
    - Texels and wavelets without it: fewer than half of the coefficients are effectively determined at 1 % noise.

    Args:
        transfer: the scene's transport at the basis' resolution.
        visible: the samples that photographs show.
        basis: what light is to be made of.
        nonnegative: whether the solver keeps radiance non-negative.
    """
    samples = int(visible.sum().item())
    if basis.size > samples:
        return (
            f"{basis.size} coefficients from {samples} usable samples: more than the scene can determine; "
            "use a coarser light or more receiver.samples"
        )
    if nonnegative or not bool((transfer.transport[visible] != 0).any()):
        return None
    if isinstance(basis, SphericalHarmonics):
        return _excess_bandwidth(transfer, visible, basis)
    found = degrees_of_freedom(whitened(transfer, visible, WARNING_NOISE).transport)
    if found >= basis.size / 2:
        return None
    return (
        f"{basis.size} coefficients, but about {found:.0f} are determined at 1 % noise and ridge smooths the rest; "
        "use a coarser --resolution, or --solver nnls"
    )


def _excess_bandwidth(transfer: Transfer, visible: Bool[Tensor, " points"], basis: SphericalHarmonics) -> str | None:
    asked = basis.degree + 1
    checked = SphericalHarmonics(min(asked, LARGEST_CHECKED) - 1, basis.resolution)
    rows = equations(Transfer(transfer.transport[visible].double(), transfer.resolution).project(checked), len(visible))
    found = nullity(rows, random_rotations(WARNING_ROTATIONS, seed=0, device=rows.device)).recommended()
    if found >= min(asked, LARGEST_CHECKED):
        return None
    cure = f"use --degree {found - 1}" if found else "use another scene"
    return (
        f"degree {basis.degree} asks for bandwidth {asked}, but the visible samples determine harmonics only up to "
        f"B = {found} without a constraint; {cure}, or --solver nnls"
    )
