"""The public door: what is refused, and in which words."""

from __future__ import annotations

from collections.abc import Iterator

import jaxtyping
import pytest
import torch

from torchlight.errors import ShapeError
from torchlight.solvers import LeastSquares

MATRIX = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
SAMPLES = torch.ones(2, 4, 5)
NAN_MATRIX = torch.full((5, 3), torch.nan)


@pytest.fixture
def _as_in_production() -> Iterator[None]:
    """Annotations are checked in tests only; here the door must hold without them."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("_as_in_production")
@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"matrix": MATRIX.half()}, "matrix: expected float32 or float64, got torch.float16"),
        ({"matrix": MATRIX[0]}, "matrix: expected a matrix"),
        ({"matrix": MATRIX[:, :0]}, "at least one row and column"),
        ({"matrix": NAN_MATRIX}, "matrix: holds NaN"),
        ({"samples": SAMPLES[0, 0]}, "samples: expected shape"),
        ({"samples": SAMPLES[..., :4]}, "samples: expected shape"),
        ({"samples": SAMPLES.double()}, "samples: expected torch.float32 on cpu"),
        ({"samples": SAMPLES.to("meta")}, "samples: expected torch.float32 on cpu"),
        ({"weights": torch.ones(2, 4, 5)}, "no channel axis"),
        ({"weights": torch.ones(5)}, r"weights: expected shape \[2, 5\]"),
        ({"weights": -torch.ones(2, 5)}, "weights: some are negative"),
        ({"weights": torch.full((2, 5), torch.nan)}, "weights: some are negative, NaN"),
        ({"weights": torch.ones(2, 5).double()}, "weights: expected torch.float32"),
        ({"synthesis": torch.ones(7, 4)}, "synthesis: expected 3 columns"),
        ({"synthesis": torch.ones(7, 3).double()}, "synthesis: expected torch.float32"),
    ],
)
def test_malformed_problems_are_refused_in_one_line(fields, words):
    with pytest.raises(ShapeError, match=words) as caught:
        LeastSquares(**({"matrix": MATRIX, "samples": SAMPLES} | fields))
    assert "\n" not in str(caught.value)


def test_well_formed_problem_is_accepted():
    problem = LeastSquares(MATRIX, SAMPLES, torch.zeros(2, 5), torch.ones(7, 3))
    assert problem.samples is SAMPLES
