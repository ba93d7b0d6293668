"""The scattered energy in squares about any point near the spot, from a table that all fields share [mm].

A square about c sees the Gaussian N(s^2) of a ray that lands at c + (dx, dy) as

    sum_ab dx^a dy^b/(a! b!) I_a(w; s) I_b(w; s),   I_a = Int_-w^w (-d/dx)^a N(x; s^2) dx,

a and b even by symmetry. The sums of I_a I_b over the wide Gaussians know nothing of the field: a field adds the
moments of its spot about each centre. Gaussians too narrow for that come from rays (narrow.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import interval_integrals
from psfcli.image.geometric import MAX_MOMENT, GeometricalImage
from psfcli.image.narrow import narrow_in_squares
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]

_PAIRS = [(a, b) for a in range(0, MAX_MOMENT + 1, 2) for b in range(a, MAX_MOMENT + 1 - a, 2)]
_SHARE = 0.3  # of the tolerance, for all wide terms together and for all narrow ones
# |I_a| s^a is at most 1 for a = 0 and 0.87 sqrt((a-1)!) beyond, by |He_n(u)| <= 1.09 sqrt(n!) exp(u^2/4)
_LARGEST = np.array([1.0] + [0.87 * math.sqrt(math.factorial(a - 1)) for a in range(1, MAX_MOMENT + 1)])
_FACTORIAL = np.array([math.factorial(a) for a in range(MAX_MOMENT + 1)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class SquareResponse:
    """What squares of increasing ``half_width`` hold of a ``mixture`` (by increasing variance), ready for any spot.

    ``response[k]`` (pair, box) sums I_a I_b over the terms from the k-th on; ``remainder[k]`` [mm^-14] their
    |weight| s^-14, to which the last order kept, and so the error, is proportional.
    """

    half_width: Real
    mixture: GaussianMixture
    response: Real
    remainder: Real

    def energy(
        self, point: GeometricalImage, centres: Sequence[tuple[float, float]], moments: Real, tolerance: float
    ) -> Real:
        """The scattered light in each square about each of the ``centres``, of all light, within ``tolerance``.

        Shape [centre, box]. ``moments`` are the spot's ``even_moments`` about the same centres.
        """
        if self.mixture.weight.size == 0 or self.half_width.size == 0:
            return np.zeros((len(centres), self.half_width.size))
        first = int(np.count_nonzero(self.remainder * _last_order(moments) > _SHARE * tolerance))
        a, b = np.array(_PAIRS).T // 2
        paired = moments[:, a, b] + np.where(a != b, moments[:, b, a], 0.0)
        energy: Real = paired @ self.response[first]
        if first:
            narrow = GaussianMixture(self.mixture.weight[:first], self.mixture.variance[:first])
            error = _SHARE * tolerance / (first * np.abs(narrow.weight))
            energy += narrow_in_squares(
                point, narrow, centres, self.half_width, error, np.full(len(centres), _SHARE * tolerance)
            )
        return energy


@dataclass(frozen=True, slots=True)
class JudgedSquares:
    """Squares whose light comes twice: as ``used`` in all, and from a ``finer`` mixture in those at some ``places``."""

    used: SquareResponse
    finer: SquareResponse
    places: slice

    def energy(
        self, point: GeometricalImage, centres: Sequence[tuple[float, float]], tolerance: float, finer_tolerance: float
    ) -> tuple[Real, float]:
        """The scattered light in the squares about each of the ``centres``, [centre, box], and how far the two differ.

        Each within its tolerance, of all light.
        """
        moments = even_moments(point, centres)
        energy = self.used.energy(point, centres, moments, tolerance)
        truth = self.finer.energy(point, centres, moments, finer_tolerance)
        return energy, float(np.max(np.abs(energy[:, self.places] - truth), initial=0.0))


def square_response(mixture: GaussianMixture, half_width: Real) -> SquareResponse:
    """The table for squares of increasing ``half_width`` [mm]."""
    order = np.argsort(mixture.variance)
    weight, variance = mixture.weight[order], mixture.variance[order]
    integral = interval_integrals(-half_width, half_width, variance, MAX_MOMENT)
    response = np.zeros((weight.size + 1, len(_PAIRS), half_width.size))
    for n, (a, b) in enumerate(_PAIRS):
        response[:-1, n] = integral[a] * integral[b] * weight[:, None]
    return SquareResponse(
        half_width,
        GaussianMixture(weight, variance),
        np.cumsum(response[::-1], axis=0)[::-1],
        np.cumsum((np.abs(weight) * variance ** (-0.5 * MAX_MOMENT))[::-1])[::-1],
    )


def even_moments(point: GeometricalImage, centres: Sequence[tuple[float, float]]) -> Real:
    """E[dx^a dy^b]/(a! b!) about each of the ``centres`` for even a and b: shape (centre, a/2, b/2)."""
    rays = point.rays
    x, y = (
        _powers((of_rays - of_centres[:, None]) ** 2) / _FACTORIAL[::2, None, None]
        for of_rays, of_centres in zip((rays.x, rays.y), np.array(centres).T, strict=True)
    )
    moments: Real = (x * rays.share).swapaxes(0, 1) @ np.moveaxis(y, 0, 2)
    return moments


def _powers(x: Real) -> Real:
    """x^0 to x^(MAX_MOMENT/2), shape (power, *x.shape)."""
    powers = np.ones((MAX_MOMENT // 2 + 1, *x.shape))
    for n in range(1, len(powers)):
        np.multiply(powers[n - 1], x, out=powers[n])
    return powers


def _last_order(moments: Real) -> float:
    """A bound of the terms of order MAX_MOMENT for unit width and weight about any centre."""
    a = np.arange(0, MAX_MOMENT + 1, 2)
    return float(np.max(moments[:, a // 2, (MAX_MOMENT - a) // 2] @ (_LARGEST[a] * _LARGEST[MAX_MOMENT - a])))
