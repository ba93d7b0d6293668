"""Quasi-random numbers: points that fill the unit cube more evenly than chance, shifted by chance as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import count, islice

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Words = NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class QuasiRandom:
    """A shifted Kronecker sequence: point i is frac(i a + shift) in [0, 1), as multiples of 2^-53.

    a_j is the root of the j-th prime (Richtmyer's sequence): evenly spread in each coordinate, however many there are.
    As the shift is uniform, so is every point, and means over the points are unbiased; but only means of several shifts
    tell their error. ``step`` and ``shift`` are fractions of 2^64, shape (dimensions, 1).
    """

    step: Words
    shift: Words

    @classmethod
    def drawn(cls, generator: np.random.Generator, dimensions: int) -> QuasiRandom:
        """The sequence with a shift by chance."""
        primes = (p for p in count(2) if all(p % d for d in range(2, math.isqrt(p) + 1)))
        step = [math.isqrt(p << 128) % 2**64 for p in islice(primes, dimensions)]  # the fraction of the root
        return cls(
            np.array(step, dtype=np.uint64)[:, None], generator.integers(0, 2**64, (dimensions, 1), dtype=np.uint64)
        )

    def points(self, dimensions: slice, first: int, number: int) -> Real:
        """Some coordinates of ``number`` points from the ``first`` on, shape (dimensions, number)."""
        i = np.arange(first, first + number, dtype=np.uint64)
        # whole numbers wrap at 2^64: the fractional part
        return np.multiply((i * self.step[dimensions] + self.shift[dimensions]) >> np.uint64(11), 2.0**-53)
