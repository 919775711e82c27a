"""Failure is data, until someone asks."""

from __future__ import annotations

import pytest
import torch

from torchlight.errors import SolveError
from torchlight.solvers import Solution, Status


def solution(status: list[list[int]]) -> Solution:
    codes = torch.tensor(status)
    figure = torch.zeros(codes.shape)
    return Solution(torch.zeros(*codes.shape, 2), codes, torch.zeros_like(codes), figure, figure, figure)


def test_check_is_silent_when_all_converged():
    solution([[0, 0], [0, 0]]).check()
    assert Status.CONVERGED == 0


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Status.STOPPED_SHORT, "step limit"),
        (Status.NOT_FINITE, "NaN"),
        (Status.NO_OBSERVATIONS, "mask"),
    ],
)
def test_check_names_item_cause_and_cure(code, words):
    with pytest.raises(SolveError, match=rf"\(1, 0\).*{words}") as caught:
        solution([[0, 0], [int(code), 0]]).check()
    assert "\n" not in str(caught.value)


def test_check_names_a_few_items_and_counts_the_rest():
    with pytest.raises(SolveError, match=r"\(0, 4\) and 2 more: .*\(1 others failed otherwise\)"):
        solution([[1] * 7 + [2]]).check()
