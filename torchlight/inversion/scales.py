"""Exposures of photographs of one light, found from the photographs themselves.

Photograph i shows v_i = s_i A_i L: its own transport A_i, the light L >= 0 of all, and its exposure s_i, one number for
all channels. Multiplying L and dividing every s by one factor changes nothing, so one exposure at least is fixed: those
that are given or, where none is, the first, which is 1. The others minimise, over L and s,

    F = sum over i of w_i |v_i - s_i A_i L|^2 / (m_i n_i)^2,   m_i = brightness of photograph i,

where n_i is the noise of photograph i as a share of its brightness: equal at first, then as the residuals of a first
solve say, so that a poor photograph beside a good one does no harm. Given s, L is a non-negative least squares. The
minimum over L is a function of log s, and Gauss-Newton's step (variable projection) is

    M step = g,   M_ij = d_i' (I - Q Q') d_j,   g_i = d_i' (v - s A L),

where d_i is photograph i's share of the prediction, the others' set to 0, and Q spans the columns of the lit texels: as
far as light can make up for an exposure, the photographs do not tell it. M^-1 is therefore the covariance of log s. A
step that does not lower F is replaced by g_i / |d_i|^2, the best exposures for the light at hand, which always does.

References:
    Kaufman (1975), A variable projection method for solving separable nonlinear least squares problems.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import SceneError, SolveError
from torchlight.photo.observation import Observation
from torchlight.solvers import NNLS, LeastSquares

TOLERANCE = 1e-5  # the last step, in log s; steps shrink quadratically
MAX_ROUNDS = 30
LONGEST_STEP = 0.5
BRIGHT = 0.98  # quantile of the used samples that counts as a photograph's brightness
LEAST_NOISE = 1e-3  # of the brightness; rounding to 8 bits is 0.0011
DOUBTFUL = 0.02  # relative standard deviation: 5 of 255
UNDETERMINED = 1e-9  # of |d_i|^2, what is left of it beside the light


@dataclass(frozen=True, eq=False)
class Scales:
    """The exposure and the noise of every photograph.

    Attributes:
        values: s_i, in the unit of those given; relative to the first photograph where none is given.
        deviations: standard deviation of s_i / its expectation, from residuals taken as white; 0 where s_i is fixed.
        noise: standard deviation of a sample as a share of the photograph's brightness, from its residual, at least
            0.001; what light of 16 x 16 texels per face cannot explain counts as noise.
        rounds: least-squares solves spent.
        converged: whether the last step was below 1e-5.
    """

    values: Float[Tensor, " photos"]
    deviations: Float[Tensor, " photos"]
    noise: Float[Tensor, " photos"]
    rounds: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Rows:
    """One photograph's equations A L = v / m with no more rows than unknowns and channels.

    Attributes:
        matrix: A, weighted and turned.
        target: v / m, likewise.
        count: samples that were used.
    """

    matrix: Float[Tensor, "rows texels"]
    target: Float[Tensor, "channels rows"]
    count: int


@dataclass(frozen=True, eq=False)
class Fit:
    """The best light for some exposures.

    Attributes:
        logs: ln(s_i / m_i).
        light: L.
        residual: sum of squares F.
    """

    logs: Float[Tensor, " photos"]
    light: Float[Tensor, "channels texels"]
    residual: float


def find_scales(
    transports: Sequence[Float[Tensor, "_ texels"]],
    observations: Sequence[Observation],
    given: Sequence[float | None],
) -> Scales:
    """Returns the exposures of photographs of one light, in float64.

    Args:
        transports: T of each photograph's scene, on the same texels.
        observations: irradiance samples [channels points] of each, up to its exposure.
        given: exposures that are known; None = to be found.

    Raises:
        SceneError: a photograph is black.
        SolveError: the photographs do not determine an exposure.
    """
    brightness = torch.stack([bright(observation, index) for index, observation in enumerate(observations)])
    fixed, logs = starts(brightness, given)
    parts = zip(transports, observations, brightness, strict=True)
    rows = [compressed(transport, observation, level) for transport, observation, level in parts]
    fit, first, _ = minimized(rows, logs, ~fixed)
    noise = residual_noise(rows, fit).clamp(min=LEAST_NOISE)
    rows = [by_noise(part, share) for part, share in zip(rows, noise, strict=True)]
    fit, second, converged = minimized(rows, fit.logs, ~fixed)
    noise = (noise * residual_noise(rows, fit)).clamp(min=LEAST_NOISE)
    values = in_units(fit.logs, brightness, given)
    return Scales(values, deviations(rows, fit, ~fixed), noise, first + second, converged)


def minimized(
    rows: Sequence[Rows], logs: Float[Tensor, " photos"], free: Bool[Tensor, " photos"]
) -> tuple[Fit, int, bool]:
    """Returns the least F, the solves spent, and whether the last step was below the tolerance."""
    fit, rounds, converged = best_light(rows, logs), 1, not bool(free.any())
    while rounds < MAX_ROUNDS and not converged:
        step, fallback = steps(rows, fit, free)
        trial = best_light(rows, fit.logs + step)
        if trial.residual > fit.residual * (1 + TOLERANCE):
            step, trial = fallback, best_light(rows, fit.logs + fallback)
            rounds += 1
        fit, rounds, converged = trial, rounds + 1, bool(step.abs().max() <= TOLERANCE)
    return fit, rounds, converged


def bright(observation: Observation, index: int = 0) -> Float[Tensor, ""]:
    """Returns the quantile 0.98 of the used samples' mean over channels; SceneError where it is not positive."""
    used = observation.weights > 0
    grey = observation.samples[:, used].double().mean(dim=0)
    level = grey.sort().values[math.ceil(BRIGHT * (len(grey) - 1))] if len(grey) else grey.new_zeros(())
    if not 0 < level.item() < math.inf:
        raise SceneError(
            f"photograph {index + 1}: black, or no sample of it can be used; it tells nothing of the light"
        )
    return level


def starts(
    brightness: Float[Tensor, " photos"], given: Sequence[float | None]
) -> tuple[Bool[Tensor, " photos"], Float[Tensor, " photos"]]:
    """Returns which exposures are fixed, and ln(s_i / m_i) to begin with: equal, as one light's bright plane is."""
    fixed = torch.tensor([value is not None for value in given], device=brightness.device)
    logs = torch.zeros_like(brightness)
    if not bool(fixed.any()):
        fixed[0] = True
        return fixed, logs
    known = torch.tensor([value for value in given if value is not None], dtype=torch.float64, device=logs.device)
    logs[fixed] = (known / brightness[fixed]).log()
    logs[~fixed] = logs[fixed].mean()
    return fixed, logs - logs[fixed].mean()  # the light takes the factor up


def in_units(
    logs: Float[Tensor, " photos"], brightness: Float[Tensor, " photos"], given: Sequence[float | None]
) -> Float[Tensor, " photos"]:
    """Returns s_i in the unit of those given, or of the first."""
    free = logs.exp() * brightness
    known, anchor = next(((value, index) for index, value in enumerate(given) if value is not None), (1.0, 0))
    values = free * (known / free[anchor])
    stated = [values[index] if value is None else values.new_tensor(value) for index, value in enumerate(given)]
    return torch.stack(stated)


def compressed(transport: Float[Tensor, "points texels"], observation: Observation, level: Float[Tensor, ""]) -> Rows:
    """Returns the triangular factor of W^(1/2) [A, v / m]: the same sums of squares for every light and exposure."""
    used = observation.weights > 0
    root = observation.weights[used].double().sqrt()[:, None]
    both = torch.cat([transport[used].double(), observation.samples[:, used].double().T / level], dim=1)
    factor = torch.linalg.qr(root * both, mode="r").R
    texels = transport.shape[1]
    return Rows(factor[:, :texels], factor[:, texels:].T.contiguous(), int(used.sum()))


def best_light(rows: Sequence[Rows], logs: Float[Tensor, " photos"]) -> Fit:
    """Returns the non-negative light that minimises F at given exposures."""
    matrix, target, _ = joined(rows, logs)
    light = NNLS().solve(LeastSquares(matrix, target)).coefficients
    return Fit(logs, light, (light @ matrix.T - target).square().sum().item())


def steps(
    rows: Sequence[Rows], fit: Fit, free: Bool[Tensor, " photos"]
) -> tuple[Float[Tensor, " photos"], Float[Tensor, " photos"]]:
    """Returns the steps of Gauss and Newton and, to fall back on, to the best exposures for the light at hand."""
    curvature, gradient, energy = normal_equations(rows, fit)
    newton, plain = torch.zeros_like(gradient), torch.zeros_like(gradient)
    newton[free] = torch.linalg.solve(solvable(curvature, energy, free), gradient[free])
    plain[free] = gradient[free] / energy[free]
    return newton.clamp(-LONGEST_STEP, LONGEST_STEP), plain.clamp(-LONGEST_STEP, LONGEST_STEP)


def by_noise(rows: Rows, noise: Float[Tensor, ""]) -> Rows:
    """Returns the equations divided by their noise."""
    return Rows(rows.matrix / noise, rows.target / noise, rows.count)


def residual_noise(rows: Sequence[Rows], fit: Fit) -> Float[Tensor, " photos"]:
    """Returns the standard deviation of a sample of each photograph, in the unit of its equations.

    Its sum of squares, over as many samples and channels as it has beyond those that the light was fitted to: the
    trace of its part of the hat matrix Q Q'.
    """
    matrix, target, share = joined(rows, fit.logs)
    squares, fitted = matrix.new_zeros(len(rows)), matrix.new_zeros(len(rows))
    for light, values in zip(fit.light, target, strict=True):
        squares += (matrix @ light - values).square() @ share
        fitted += torch.linalg.qr(matrix[:, light > 0]).Q.square().sum(dim=1) @ share
    equations = torch.tensor([part.count * len(fit.light) for part in rows]).to(squares)
    return (squares / (equations - fitted).clamp(min=1)).sqrt()


def deviations(rows: Sequence[Rows], fit: Fit, free: Bool[Tensor, " photos"]) -> Float[Tensor, " photos"]:
    """Returns the standard deviation of ln s_i by M^-1, for equations divided by their noise."""
    result = torch.zeros_like(fit.logs)
    if bool(free.any()):
        curvature, _, energy = normal_equations(rows, fit)
        result[free] = torch.linalg.inv(solvable(curvature, energy, free)).diagonal().sqrt()
    return result


def joined(
    rows: Sequence[Rows], logs: Float[Tensor, " photos"]
) -> tuple[Float[Tensor, "rows texels"], Float[Tensor, "channels rows"], Float[Tensor, "rows photos"]]:
    """Returns s A and v / m of all photographs, and which row belongs to which."""
    matrix = torch.cat([part.matrix * log.exp() for part, log in zip(rows, logs, strict=True)])
    place = torch.cat([torch.full((len(part.matrix),), index) for index, part in enumerate(rows)])
    share = torch.nn.functional.one_hot(place, len(rows)).to(matrix)
    return matrix, torch.cat([part.target for part in rows], dim=-1), share


def normal_equations(
    rows: Sequence[Rows], fit: Fit
) -> tuple[Float[Tensor, "photos photos"], Float[Tensor, " photos"], Float[Tensor, " photos"]]:
    """Returns M, g and |d_i|^2."""
    matrix, target, share = joined(rows, fit.logs)
    curvature, gradient = matrix.new_zeros(len(rows), len(rows)), matrix.new_zeros(len(rows))
    energy = matrix.new_zeros(len(rows))
    for light, values in zip(fit.light, target, strict=True):
        predicted = matrix @ light
        parts = predicted[:, None] * share  # [rows photos]
        across, _ = torch.linalg.qr(matrix[:, light > 0])
        beside = parts - across @ (across.T @ parts)
        curvature += beside.T @ beside
        gradient += parts.T @ (values - predicted)
        energy += parts.square().sum(dim=0)
    return curvature, gradient, energy


def solvable(
    curvature: Float[Tensor, "photos photos"], energy: Float[Tensor, " photos"], free: Bool[Tensor, " photos"]
) -> Float[Tensor, "free free"]:
    """Returns M of the free exposures.

    Raises:
        SolveError: light can make up for an exposure, or a photograph is dark under it.
    """
    part, unit = curvature[free][:, free], energy[free].clamp(min=1e-300).sqrt()
    values, vectors = torch.linalg.eigh(part / unit[:, None] / unit)
    if not bool(values[0] > UNDETERMINED):
        index = int(free.nonzero()[vectors[:, 0].abs().argmax(), 0].item())
        raise SolveError(
            f"photograph {index + 1}: its exposure cannot be told from the light: no two photographs show the same "
            "light; state its exposure, or use more of the plane"
        )
    return part
