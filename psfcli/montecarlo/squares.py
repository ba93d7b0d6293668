"""Rays counted in nested squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Whole = NDArray[np.int64]

_CELLS_PER_OCTAVE = 1 << 9


class NestedSquares:
    """Squares of increasing ``half_width`` [mm], and a table that tells how many of them a point has left.

    A double's leading bits number cells that grow with it, 2^9 to a factor of two: the table has the half widths below
    each cell, and those within it are compared with one by one.
    """

    def __init__(self, half_width: Real) -> None:
        self._half_width = np.append(half_width, np.inf)
        self._reach = 0.5 * half_width[0], 2.0 * half_width[-1]
        self._shift = 52 - (_CELLS_PER_OCTAVE.bit_length() - 1)
        first, last = (int(np.float64(r).view(np.int64) >> self._shift) for r in self._reach)
        starts = (np.arange(first, last + 2, dtype=np.int64) << self._shift).view(np.float64)
        self._first = first
        self._below = np.searchsorted(half_width, starts).astype(np.int64)
        self._within = int(np.diff(self._below).max())

    def inside(self, x: Real, y: Real, centre: tuple[float, float]) -> Whole:
        """How many of the points (x, y) [mm] lie in each square about ``centre``, its edges included."""
        reach = np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1]))
        np.clip(reach, *self._reach, out=reach)
        cell = reach.view(np.int64) >> self._shift
        cell -= self._first
        left = self._below[cell]
        for _ in range(self._within):
            left += reach > self._half_width[left]
        return np.cumsum(np.bincount(left, minlength=self._half_width.size))[:-1]
