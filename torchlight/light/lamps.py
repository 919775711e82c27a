"""The strongest sources of a light as distant lamps, and the light without them: nothing is lost or counted twice.

A lamp is what stands out of the light around it. Round the texel of largest flux above its surroundings, a disc of 10
degrees is looked at. B is the median radiance, per channel, of the ring from 10 to 20 degrees about it; what exceeds B,

    e = max(0, L - B)     where its luminance is at least a tenth of the energy-weighted mean of the disc,

is the lamp, and L - e is what remains. From e follow

    direction d           V / |V|,  V = integral of luminance(e) w dw
    irradiance on z = 0   E = integral of e z dw, per channel, exact
    facing the lamp       E / d_z
    solid angle           2 pi (1 - cos a) of a uniform disc with the same mean square angle about d: a^2 = 2 <angle^2>
    radiance              (E / d_z) / (pi sin^2 a): such a disc brings E to the plane

so a lamp brings to the plane what was taken from the map, exactly and per channel. Its power in luminance differs by
less than 1 %, since it is narrow; per channel by more where a low source changes colour with height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import cubemap, latlong
from torchlight.light.environment import LUMINANCE, EnvironmentMap, irradiance, luminance
from torchlight.light.overlap import latlong_to_texels

RADIUS = math.radians(10.0)
RING = math.radians(20.0)
TEXEL_RING = math.radians(30.0)
RESOLUTION = 16  # texels along a face's edge, where lamps are looked for: 4 to 7 degrees wide
BRIGHT = 0.1  # of the energy-weighted mean excess: darker pixels of the disc stay in the map
MINIMUM_SHARE = 0.01  # of the luminance flux on the plane
MAXIMUM_COUNT = 64

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Lamp:
    """One distant source, uniform over a disc.

    Attributes:
        direction: unit vector towards it, in torchlight's world.
        solid_angle: of the disc, in steradians.
        irradiance: E on a plane that faces it, red, green, blue.
        share: of the luminance flux that the whole light brings to the plane z = 0.
    """

    direction: tuple[float, float, float]
    solid_angle: float
    irradiance: Colour
    share: float

    @property
    def radius(self) -> float:
        """Angle from the disc's middle to its rim, in radians."""
        return math.acos(max(-1.0, 1 - self.solid_angle / (2 * math.pi)))

    @property
    def radiance(self) -> Colour:
        """Of the disc: E / (pi sin^2 a)."""
        red, green, blue = (value / (math.pi * math.sin(self.radius) ** 2) for value in self.irradiance)
        return red, green, blue

    @property
    def plane_irradiance(self) -> Colour:
        """E on the plane z = 0."""
        red, green, blue = (value * self.direction[2] for value in self.irradiance)
        return red, green, blue

    @property
    def colour(self) -> Colour:
        """Red, green, blue, the largest 1."""
        largest = max(self.irradiance)
        red, green, blue = (value / largest for value in self.irradiance)
        return red, green, blue


@dataclass(frozen=True, eq=False)
class _Upper:
    """Pixels above the horizon, flattened: directions, solid angles, integrals of z dw, sizes along both axes."""

    directions: Float[Tensor, "pixels 3"]
    areas: Float[Tensor, " pixels"]
    projected: Float[Tensor, " pixels"]
    spread: Float[Tensor, " pixels"]  # mean square angle of a pixel's points from its middle


def extract_lamps(environment: EnvironmentMap, count: int) -> tuple[tuple[Lamp, ...], EnvironmentMap]:
    """Returns at most `count` lamps, strongest first, and the light without them.

    A source that brings less than 1 % of the luminance flux to the plane is no lamp; light from below the plane is left
    as it is. A source wider than the disc gives several lamps, or one and a rest.

    Raises:
        ConfigError: a count that is not between 0 and 64.
        ShapeError: a batch of maps.
    """
    if not 0 <= count <= MAXIMUM_COUNT:
        raise ConfigError(f"lamps: expected 0 to {MAXIMUM_COUNT}, got {count}")
    if environment.radiance.ndim != 3:
        raise ShapeError(f"lamps: expected one map [3, height, width], got {list(environment.radiance.shape)}")
    radiance = environment.radiance.detach().double().cpu()
    whole = float(luminance(irradiance(EnvironmentMap(radiance.clamp(min=0)))[:, None]))
    upper = _upper(environment.height)
    lamps: list[Lamp] = []
    rest = radiance.clone()
    flat = rest.view(3, -1)[:, : len(upper.areas)]
    for centre in _candidates(rest, count):
        taken = _excess(flat, upper, centre)
        lamp = _lamp(taken, upper, whole)
        if lamp is not None and all(_apart(lamp, other) for other in lamps):
            lamps.append(lamp)
            flat -= taken
        if len(lamps) == count:
            break
    kept = replace(environment, radiance=rest.to(environment.radiance))
    return tuple(sorted(lamps, key=lambda lamp: -lamp.share)), kept


def disc_mean(lamp: Lamp, values: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch"]:
    """Returns the mean of a lat-long map over a lamp's disc by solid angle; its middle counts where it is tiny."""
    height = values.shape[-2]
    middle = torch.tensor(lamp.direction, dtype=torch.float64)
    inside = latlong.pixel_directions(height) @ middle >= math.cos(lamp.radius)
    inside[latlong.pixel_indices(middle, height)] = True
    weights = inside * latlong.row_solid_angles(height)[:, None]
    return (values.double().cpu() * weights).sum(dim=(-2, -1)) / weights.sum()


def _upper(height: int) -> _Upper:
    rows = height // 2
    columns = 2 * height
    directions = latlong.pixel_directions(height)[:rows]
    step = math.pi / height
    sine = torch.linalg.vector_norm(directions[..., :2], dim=-1)
    spread = step**2 / 12 * (1 + sine**2)
    areas, projected = latlong.row_solid_angles(height)[:rows], latlong.row_projected_solid_angles(height)[:rows]
    return _Upper(
        directions.reshape(-1, 3),
        areas[:, None].expand(rows, columns).reshape(-1),
        projected[:, None].expand(rows, columns).reshape(-1),
        spread.reshape(-1),
    )


def _apart(first: Lamp, second: Lamp) -> bool:
    """Returns whether two lamps are two sources, not one and the glare about it."""
    return sum(a * b for a, b in zip(first.direction, second.direction, strict=True)) < math.cos(RADIUS)


def _candidates(radiance: Float[Tensor, "3 height width"], count: int) -> list[Float[Tensor, "3"]]:
    """Returns directions to look at, those of the texels whose flux stands out most of their surroundings first.

    A texel within the disc of an earlier one is left out: its light is part of that lamp.
    """
    if count == 0:
        return []
    cells = cubemap.texel_cells(RESOLUTION, 1)
    directions = cubemap.cell_directions(cells)[:, 0].double()
    weights = cubemap.cell_cosine_weights(cells)[:, 0].double()
    values = luminance(latlong_to_texels(radiance, RESOLUTION))
    cosines = directions @ directions.T
    ring = (cosines < math.cos(RADIUS)) & (cosines > math.cos(TEXEL_RING))
    around = torch.where(ring, values, torch.nan).nanmedian(dim=1).values
    excess = (values - around) * weights
    found: list[int] = []
    for index in excess.argsort(descending=True).tolist():
        if not bool(excess[index] > 0) or len(found) == 2 * count + 4:
            break
        if all(float(cosines[index, other]) < math.cos(RADIUS) for other in found):
            found.append(index)
    near = cosines[found] >= math.cos(RADIUS / 2)
    light = torch.where(near, excess.clamp(min=0), 0)
    return list(torch.nn.functional.normalize(light @ directions, dim=-1))


def _excess(
    radiance: Float[Tensor, "3 pixels"], upper: _Upper, centre: Float[Tensor, "3"]
) -> Float[Tensor, "3 pixels"]:
    """Returns e about a direction, after the disc has been moved to the middle of what it held."""
    taken = torch.zeros_like(radiance)
    for _ in range(3):
        cosine = upper.directions @ centre
        disc = cosine >= math.cos(RADIUS)
        ring = ~disc & (cosine >= math.cos(RING))
        if not bool(ring.any()):  # pixels of tens of degrees: nothing to compare with
            return torch.zeros_like(radiance)
        background = _medians(radiance[:, ring], upper.areas[ring])
        taken = (radiance - background[:, None]).clamp(min=0) * _bright(radiance, background, upper, disc)
        flow = luminance(taken) * upper.areas
        if not bool(flow.sum() > 0):
            return taken
        centre = torch.nn.functional.normalize(flow @ upper.directions, dim=-1)
    return taken


def _bright(
    radiance: Float[Tensor, "3 pixels"], background: Float[Tensor, "3"], upper: _Upper, disc: Bool[Tensor, " pixels"]
) -> Bool[Tensor, " pixels"]:
    """Returns which pixels of a disc belong to the lamp in it."""
    excess = luminance((radiance - background[:, None]).clamp(min=0)) * disc
    flow = excess * upper.areas
    total = flow.sum()
    mean = (excess * flow).sum() / torch.where(total > 0, total, 1)
    return disc & (excess >= BRIGHT * mean) & (excess > 0)


def _medians(values: Float[Tensor, "3 pixels"], areas: Float[Tensor, " pixels"]) -> Float[Tensor, "3"]:
    """Returns the median of each channel, weighted by solid angle, and at least 0."""
    ordered, order = values.sort(dim=1)
    half = (areas[order].cumsum(dim=1) < areas.sum() / 2).sum(dim=1, keepdim=True)
    return ordered.gather(1, half.clamp(max=values.shape[1] - 1))[:, 0].clamp(min=0)


def _lamp(taken: Float[Tensor, "3 pixels"], upper: _Upper, whole: float) -> Lamp | None:
    """Returns the lamp that brings to the plane what was taken; None where that is less than 1 % of the whole."""
    received = taken @ upper.projected
    share = float(received @ torch.tensor(LUMINANCE, dtype=received.dtype)) / whole if whole > 0 else 0.0
    if share < MINIMUM_SHARE:
        return None
    flow = luminance(taken) * upper.areas
    direction = torch.nn.functional.normalize(flow @ upper.directions, dim=-1)
    chord = torch.linalg.vector_norm(upper.directions - direction, dim=-1)
    square = (flow * ((2 * torch.asin(chord / 2)) ** 2 + upper.spread)).sum() / flow.sum()
    radius = min(math.sqrt(2 * float(square)), RADIUS)
    x, y, z = direction.tolist()
    red, green, blue = (received / z).tolist()
    return Lamp((x, y, z), 2 * math.pi * (1 - math.cos(radius)), (red, green, blue), share)
