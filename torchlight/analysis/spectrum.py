"""The transfer function V max(0, cos theta) of every sample in the frequency domain, and its slices.

Without shadows it is the clamped cosine, a low-pass filter: over 99 % of its energy lies in l <= 2. Shadows cut pieces
out of the cosine, and the edges of the pieces carry the high frequencies that make light visible in a shadow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene, shadowing
from torchlight.geometry.visibility import scene_occlusion
from torchlight.light import cubemap
from torchlight.light.bases import SphericalHarmonics
from torchlight.transfer import Transfer

SLICE_QUANTILES = (0.05, 0.3, 0.7)  # of the irradiance under uniform light: deep, half and faint shadow
TOTAL_NODES = 6  # Gauss-Legendre nodes per axis for the integral of cos^2 over a texel


@dataclass(frozen=True, eq=False)
class Slices:
    """The transfer function along half circles from the horizon through the normal to the other horizon (Fig. 1).

    Attributes:
        samples: index of each sample in the receiver.
        azimuth_radians: of the half at positive angles, one per sample.
        angle_radians: from the normal, -pi/2 to pi/2.
        values: V cos(angle).
    """

    samples: Int[Tensor, " samples"]
    azimuth_radians: Float[Tensor, " samples"]
    angle_radians: Float[Tensor, " angles"]
    values: Float[Tensor, "samples angles"]


def transfer_harmonics(transfer: Transfer, degree: int) -> Float[Tensor, "points {(degree+1)**2}"]:
    """Returns T_lm of every sample for l = 0 .. degree (eq. 5), in float64.

    Each texel contributes its transport times the cosine-weighted average of Y_lm over it: exact where visibility is
    constant within every texel, and elsewhere as fine as the transport's texels.
    """
    basis = SphericalHarmonics(degree, transfer.resolution)
    synthesis = basis.synthesis_matrix(device=transfer.transport.device)
    return transfer.transport.to(synthesis) @ synthesis


def energy_per_degree(harmonics: Float[Tensor, "*batch coeffs"]) -> Float[Tensor, "*batch degrees"]:
    """Returns the sum over m of T_lm^2 for every l; its sum over all l is the integral of V cos^2 over the sphere."""
    degrees = math.isqrt(harmonics.shape[-1])
    parts = harmonics.square().split([2 * l + 1 for l in range(degrees)], dim=-1)
    return torch.stack([part.sum(dim=-1) for part in parts], dim=-1)


def total_energy(transfer: Transfer) -> Float[Tensor, " points"]:
    """Returns the integral of (V cos theta)^2 over the hemisphere, V constant over each texel; 2 pi / 3 unoccluded."""
    cells = cubemap.texel_cells(transfer.resolution)
    directions, weights = (part[:, 0] for part in cubemap.gauss_nodes(cells, TOTAL_NODES))
    squares = (weights * directions[..., 2] ** 2).sum(dim=-1)
    cosines = cubemap.cell_cosine_weights(cells)[:, 0]
    transport = transfer.transport.double()
    return transport.square() @ (squares / cosines**2).to(transport)


def clamped_cosine(
    degree: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{degree+1}"]:
    """Returns T_l0 of an unoccluded plane for l = 0 .. degree; all other T_lm are 0.

    T_l0 = sqrt((2l + 1) / 4 pi) A_l with A_0 = pi, A_1 = 2 pi / 3, A_l = 0 for odd l > 1 and, for even l,

        A_l = 2 pi (-1)^(l/2 - 1) / ((l + 2) (l - 1)) l! / (2^l (l/2)!^2)

    References:
        Ramamoorthi and Hanrahan (2001), An efficient representation for irradiance environment maps, eq. 8.
    """
    values = [math.sqrt((2 * l + 1) / (4 * math.pi)) * _cosine_factor(l) for l in range(degree + 1)]
    return torch.tensor(values, dtype=dtype, device=device)


def _cosine_factor(l: int) -> float:
    if l == 1:
        return 2 * math.pi / 3
    if l % 2:
        return 0.0
    central = math.comb(l, l // 2) / 2**l
    return 2 * math.pi * (-1.0) ** (l // 2 - 1) / ((l + 2) * (l - 1)) * central


def representative_samples(transfer: Transfer, used: Int[Tensor, " used"]) -> Int[Tensor, " samples"]:
    """Returns one sample each of the deep, the half and the faint shadow under uniform light, among those used."""
    order = used[transfer.transport[used].sum(dim=1).argsort()]
    places = [round(quantile * (len(order) - 1)) for quantile in SLICE_QUANTILES]
    return order[torch.tensor(places, device=order.device)].unique_consecutive()


def slices(scene: Scene, samples: Int[Tensor, " samples"], angles: int = 721) -> Slices:
    """Returns the transfer function of some samples' centres along the half circle through the occluders' middle."""
    centers = sample_centers(scene.receiver)[samples]
    corners = scene.triangles.reshape(-1, 3).double()[:, :2]
    middle = (corners.amin(dim=0) + corners.amax(dim=0)) / 2 if len(corners) else centers.new_zeros(2)
    towards = middle - centers
    azimuth = torch.atan2(towards[:, 1], towards[:, 0])
    # strictly above the plane: a ray along it says nothing about an occluder that stands on it
    angle = torch.linspace(-0.5, 0.5, angles + 2, dtype=torch.float64)[1:-1] * math.pi
    test = scene_occlusion(shadowing(scene))
    values = []
    for center, turn in zip(centers, azimuth, strict=True):
        directions = torch.stack([angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos()], dim=1)
        point = torch.cat([center, center.new_zeros(1)])[None]
        hidden = test.hidden_on_plane(point.numpy(), directions.numpy(), np.zeros((angles, 2)))[:, 0]
        values.append(torch.where(torch.from_numpy(hidden), torch.zeros_like(angle), angle.cos()))
    return Slices(samples, azimuth, angle, torch.stack(values))
