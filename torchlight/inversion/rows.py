"""Matrices that grow in place, with room to spare: what is there is copied now and then, not each time."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


class Rows:
    """A matrix that rows are appended to."""

    def __init__(self, first: Float[Tensor, "n width"]) -> None:
        """Starts with some rows, not copied."""
        self._room, self._count = first, first.shape[0]

    @property
    def all(self) -> Float[Tensor, "n width"]:
        """The rows so far, contiguous."""
        return self._room[: self._count]

    def append(self, rows: Float[Tensor, "k width"]) -> None:
        """Adds rows at the end."""
        total = self._count + rows.shape[0]
        if total > self._room.shape[0]:
            room = rows.new_empty(max(total, 2 * self._count), rows.shape[1])
            room[: self._count] = self.all
            self._room = room
        self._room[self._count : total] = rows
        self._count = total


class SymmetricRows:
    """A symmetric matrix that rows, and columns with them, are appended to."""

    def __init__(self, first: Float[Tensor, "n n"]) -> None:
        """Starts with a symmetric matrix, not copied."""
        self._count, self.room = first.shape[0], first

    @property
    def all(self) -> Float[Tensor, "n n"]:
        """The matrix so far, a part of `room`, which is contiguous."""
        return self.room[: self._count, : self._count]

    def append(self, rows: Float[Tensor, "k total"]) -> None:
        """Adds rows that reach to the new diagonal, and their transpose as columns."""
        known, total = self._count, rows.shape[1]
        if total > self.room.shape[0]:
            room = rows.new_empty(max(total, 2 * known), max(total, 2 * known))
            room[:known, :known] = self.all
            self.room = room
        self.room[known:total, :total] = rows
        self.room[:known, known:total] = rows[:, :known].T
        self._count = total
