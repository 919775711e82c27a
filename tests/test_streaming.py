"""A stream of frames: the light of each is that of SciPy, a bad one harms no other, and nothing is kept."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import jaxtyping
import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor

import torchlight as tl
from torchlight.errors import ConfigError, ShapeError
from torchlight.solvers import NNLS, LeastSquares, Status, prepared
from torchlight.solvers.certificate import kkt_cosine
from torchlight.solvers.modulus import QUICK, Stages

POINTS, TEXELS, FRAMES = 80, 24, 5


@pytest.fixture
def unannotated() -> Iterator[None]:
    """Wrong shapes must reach the hand-written check."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def transport(kind: str = "independent") -> Tensor:
    """A non-negative matrix, of short and long columns; some zero, or some dependent."""
    g = torch.Generator().manual_seed(0)
    matrix = torch.rand(POINTS, TEXELS, generator=g, dtype=torch.float64) ** 4
    matrix *= 10.0 ** torch.linspace(-2, 1, TEXELS, dtype=torch.float64)
    if kind == "dependent":
        matrix[:, 5] = matrix[:, 3] + 2 * matrix[:, 4]
    if kind == "unseen":
        matrix[:, ::4] = 0
    return matrix


def frames(matrix: Tensor, noise: float = 0.3) -> Tensor:
    """Frames of lights of which half the texels are dark, with noise: negative samples too."""
    g = torch.Generator().manual_seed(1)
    light = torch.rand(FRAMES, 3, TEXELS, generator=g, dtype=torch.float64)
    shown = torch.where(light > 0.5, light, 0.0) @ matrix.T
    return shown + noise * torch.randn(shown.shape, generator=g, dtype=torch.float64)


@pytest.mark.parametrize("kind", ["independent", "dependent", "unseen"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
def test_every_frame_has_the_residual_of_scipy_and_the_certificate_it_claims(kind: str, tolerance: float) -> None:
    matrix = transport(kind)
    video = frames(matrix)
    (found,) = tl.stream(matrix, [video], tolerance=tolerance)
    found.check()
    assert found.coefficients.min().item() >= 0
    norms = np.linalg.norm(matrix.numpy(), axis=0)
    for x, b, kkt, residual in zip(
        found.coefficients.flatten(0, 1), video.flatten(0, 1), found.kkt_residual.flatten(),
        found.relative_residual.flatten(), strict=True,
    ):  # fmt: skip
        r = b - matrix @ x
        cosines = (matrix.T @ r).numpy() / np.where(norms > 0, norms, 1.0) / r.norm().item()
        worst = np.where(x.numpy() > 0, abs(cosines), cosines.clip(min=0)).max()
        assert worst <= tolerance
        assert kkt.item() == pytest.approx(worst, rel=1e-4, abs=1e-12)
        assert residual.item() == pytest.approx((r.norm() / b.norm()).item(), rel=1e-9)
        _, least = nnls(matrix.numpy(), b.numpy())
        assert least * (1 - 1e-12) <= r.norm().item() <= least * (1 + tolerance)


@pytest.mark.parametrize("kind", ["independent", "unseen"])
def test_frames_are_solved_where_their_transport_is(kind: str, device: torch.device) -> None:
    matrix = transport(kind)
    video = frames(matrix)
    video[1, 2, 7] = torch.inf
    video[2] = 0.0
    (right,) = tl.stream(matrix, [video], tolerance=1e-8)
    (found,) = tl.stream(matrix.to(device), [video.to(device)], tolerance=1e-8)
    assert found.coefficients.device.type == device.type
    assert found.status.tolist() == right.status.tolist()
    assert torch.allclose(
        found.coefficients.cpu(), right.coefficients, rtol=0, atol=1e-7 * float(video.nan_to_num(0, 0, 0).max())
    )
    assert torch.allclose(found.relative_residual.cpu(), right.relative_residual, rtol=1e-9, atol=1e-12, equal_nan=True)


def test_gap_bounds_the_true_one() -> None:
    matrix = transport()
    video = frames(matrix)
    (found,) = tl.stream(matrix, [video], tolerance=0.3)
    (exact,) = tl.stream(matrix, [video], tolerance=1e-9)
    true = found.relative_residual**2 - exact.relative_residual**2
    assert bool((true > 1e-6).any())  # the tolerance was used
    assert bool((found.gap >= true - 1e-14).all())


def test_light_is_that_of_the_solver_of_photographs() -> None:
    """Weights, RGB and float32 included; a sample of weight 0 may hold anything."""
    matrix = transport("unseen").float()
    video = frames(transport("unseen")).float()
    weights = torch.rand(POINTS, generator=torch.Generator().manual_seed(2))
    weights[7] = 0
    expected = NNLS().solve(LeastSquares(matrix, video, weights.expand(FRAMES, -1)))
    video[..., 7] = torch.nan
    (found,) = tl.stream(matrix, [video], weights, tolerance=1e-7)
    assert found.coefficients.dtype == torch.float32
    torch.testing.assert_close(found.coefficients, expected.coefficients, rtol=1e-4, atol=1e-5)
    assert not found.coefficients[..., ::4].any()


def test_blocks_and_frames_alone_have_the_light_of_the_whole() -> None:
    matrix = transport()
    video = frames(matrix)
    (whole,) = tl.stream(matrix, [video], tolerance=1e-9)
    alone = torch.cat([part.coefficients for part in tl.stream(matrix, video.split(1), tolerance=1e-9)])
    torch.testing.assert_close(alone, whole.coefficients, rtol=1e-6, atol=1e-8)


def test_bad_frames_have_a_status_of_their_own_and_harm_no_other() -> None:
    matrix = transport()
    video = frames(matrix)
    bad = video.clone()
    bad[1, 2, 5] = torch.nan
    bad[2] = torch.inf
    bad[3] = 0
    good, found = (next(tl.stream(matrix, [block])) for block in (video, bad))
    expected = torch.zeros(FRAMES, 3, dtype=torch.int64)
    expected[1, 2] = expected[2] = int(Status.NOT_FINITE)
    assert torch.equal(found.status, expected)
    assert not found.coefficients[1, 2].any()
    assert not found.coefficients[2:4].any()
    assert bool(torch.isnan(found.kkt_residual[2]).all())
    assert not found.kkt_residual[3].any()
    for frame, channels in ((0, slice(None)), (1, slice(2)), (4, slice(None))):
        assert torch.equal(found.coefficients[frame, channels], good.coefficients[frame, channels])


def test_blocks_are_read_one_by_one_and_not_kept() -> None:
    matrix = transport()
    read: list[weakref.ref[Tensor]] = []

    def endless() -> Iterator[Tensor]:
        while True:
            block = frames(matrix)
            read.append(weakref.ref(block))
            yield block
            del block

    lights = tl.stream(matrix, endless())
    assert not read
    for count in (1, 2, 3):
        assert next(lights).coefficients.shape == (FRAMES, 3, TEXELS)
        assert len(read) == count
    gc.collect()
    assert sum(block() is not None for block in read) <= 1  # the one that the generator itself still holds


def test_what_the_frames_share_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Stages] = []
    genuine = prepared.modulus_of
    monkeypatch.setattr(prepared, "modulus_of", lambda gram, stages: made.append(stages) or genuine(gram, stages))
    matrix = transport()
    assert len(list(tl.stream(matrix, frames(matrix).split(1)))) == FRAMES
    assert made == [QUICK]


def test_a_looser_tolerance_takes_less() -> None:
    matrix = transport()
    video = frames(matrix)
    steps = [next(tl.stream(matrix, [video], tolerance=tolerance)).steps.sum().item() for tolerance in (0.1, 1e-9)]
    assert steps[0] < steps[1]


def test_a_block_without_frames_has_no_light() -> None:
    (found,) = tl.stream(transport(), [torch.zeros(0, 3, POINTS, dtype=torch.float64)])
    assert found.coefficients.shape == (0, 3, TEXELS)
    assert found.status.shape == (0, 3)


def test_many_threads_share_a_block() -> None:
    assert prepared.parts(96, 2) == [slice(0, 48), slice(48, 96)]
    assert prepared.parts(96, 1) == [slice(0, 48), slice(48, 96)]
    assert prepared.parts(3, 2) == [slice(0, 2), slice(2, 3)]
    assert prepared.parts(0, 2) == []


def test_cosine_of_a_known_triangle() -> None:
    """Columns e1 and e2, b = (3, -4) / 5: at x = (0.6, 0) the residual is orthogonal to e1 and points away from e2."""
    b = torch.tensor([[0.6, -0.8]], dtype=torch.float64)
    for x, cosine in (([0.6, 0.0], 0.0), ([0.0, 0.0], 0.6), ([0.2, 0.0], 0.4 / np.hypot(0.4, 0.8))):
        z = torch.tensor([x], dtype=torch.float64)
        assert kkt_cosine(z, b - z, b - z).item() == pytest.approx(cosine)
    z = torch.tensor([[0.6, 0.1]], dtype=torch.float64)
    assert kkt_cosine(z, b - z, b - z).item() == pytest.approx(1.0)  # e2 is in use, and the residual lies along it


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda m: tl.stream(m, [], tolerance=0.0), ConfigError, "tolerance in"),
        (lambda m: tl.stream(m, [], torch.ones(3).double()), ShapeError, "weights: expected shape"),
        (lambda m: tl.stream(0 * m, []), ConfigError, "got 0"),
        (lambda m: tl.stream(m, [], torch.zeros(POINTS).double()), ConfigError, "got 0"),
        (lambda m: tl.stream(m / 0, []), ShapeError, "holds NaN"),
        (lambda m: next(tl.stream(m, [torch.ones(3, 3, 7).double()])), ShapeError, "channels, 80"),
        (lambda m: next(tl.stream(m, [torch.ones(3, 3, POINTS)])), ShapeError, "float64"),
    ],
)
@pytest.mark.usefixtures("unannotated")
def test_what_cannot_be_streamed_is_said(call, error, words) -> None:
    with pytest.raises(error, match=words):
        call(transport())
