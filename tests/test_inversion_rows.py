"""Matrices that grow in place against `torch.cat`."""

from __future__ import annotations

import torch

from torchlight.inversion.rows import Rows, SymmetricRows


def test_rows_are_those_appended_in_their_order() -> None:
    generator = torch.Generator().manual_seed(0)
    for first in (0, 1, 5):
        parts = [torch.randn(n, 4, generator=generator) for n in (first, 0, 1, 3, 1, 20, 1)]
        rows = Rows(parts[0])
        kept = parts[0].clone()
        for k, part in enumerate(parts[1:], start=2):
            rows.append(part)
            assert torch.equal(rows.all, torch.cat(parts[:k]))
            assert rows.all.is_contiguous()
        assert torch.equal(parts[0], kept)  # what it began with is left alone


def test_symmetric_rows_are_the_gram_matrix_of_what_was_appended() -> None:
    generator = torch.Generator().manual_seed(1)
    vectors = torch.randint(-5, 5, (40, 6), generator=generator).double()
    for first in (0, 1, 4):
        start = (vectors[:first] @ vectors[:first].T).contiguous()
        rows, count = SymmetricRows(start), first
        for step in (1, 0, 2, 5, 1, 20, 3):
            count += step
            rows.append(vectors[count - step : count] @ vectors[:count].T)
            assert torch.equal(rows.all, vectors[:count] @ vectors[:count].T)
            assert rows.room.is_contiguous()
            assert torch.equal(rows.room[:count, :count], rows.all)
