"""The scattered energy in squares about any point near the spot, from tables that fields share [mm].

Where a Gaussian is not far narrower than the spot is wide, what squares hold of it is a short series of polynomials of
where a ray lands (square_polynomials.py): a table that all spots of like extent share. Narrower ones come from rays on
a grid, or from fans (narrow.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import GeometricalImage
from psfcli.image.narrow import narrow_in_squares
from psfcli.image.square_polynomials import PolynomialResponse, common_extent, polynomial_response
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]

_SHARE = 0.3  # of the tolerance, for what narrow ones leave out
_MOST_TABLES = 4  # held: neighbouring fields ask for the same
_LEAST_EXTENT = 1e-3  # of the narrowest Gaussian: of a spot as small as that, four polynomials leave out 1e-20


@dataclass(frozen=True, slots=True)
class SquareResponse:
    """What squares of increasing ``half_width`` hold of a ``mixture`` (by increasing variance), for any spot.

    As much as squares of the half widths ``held``: what lies beyond them belongs to all. ``tables`` are made when a
    spot first asks for them, by its extent and the tolerance.
    """

    half_width: Real
    held: Real
    mixture: GaussianMixture
    tables: dict[tuple[float, float], PolynomialResponse] = field(default_factory=dict, repr=False)

    def energy(
        self, point: GeometricalImage, centres: Sequence[tuple[float, float]], tolerance: float
    ) -> tuple[Real, float]:
        """The scattered light in each square about each of the ``centres``, of all light, within ``tolerance``.

        Shape [centre, box]; and the part of its error that no calculation of its kind shows, for fans all begin alike.
        """
        if self.mixture.weight.size == 0 or self.half_width.size == 0:
            return np.zeros((len(centres), self.half_width.size)), 0.0
        weight, variance = self.mixture.weight, self.mixture.variance
        extent = common_extent(point, centres, _LEAST_EXTENT * math.sqrt(float(variance[0])))
        if (extent, tolerance) not in self.tables:
            if len(self.tables) == _MOST_TABLES:
                self.tables.clear()
            self.tables[extent, tolerance] = polynomial_response(self.mixture, self.held, extent, tolerance)
        table = self.tables[extent, tolerance]
        energy, told = table.energy(point, centres), 0.0
        if table.first:
            narrow = GaussianMixture(weight[: table.first], variance[: table.first])
            error = _SHARE * tolerance / (table.first * np.abs(narrow.weight))
            enough = np.full(len(centres), _SHARE * tolerance)
            of_narrow, told = narrow_in_squares(point, narrow, centres, self.half_width, error, enough)
            energy += of_narrow
        return energy, told


@dataclass(frozen=True, slots=True)
class JudgedSquares:
    """Squares whose light comes twice: as ``used`` in all, and from a ``finer`` mixture in those at some ``places``."""

    used: SquareResponse
    finer: SquareResponse
    places: slice

    def energy(
        self, point: GeometricalImage, centres: Sequence[tuple[float, float]], tolerance: float, finer_tolerance: float
    ) -> tuple[Real, float]:
        """The scattered light in the squares about each of the ``centres``, [centre, box], and its estimated error.

        How far the two differ, with what the finer one tells of itself. Each within its tolerance, of all light.
        """
        energy, _ = self.used.energy(point, centres, tolerance)
        truth, error = self.finer.energy(point, centres, finer_tolerance)
        return energy, float(np.max(np.abs(energy[:, self.places] - truth), initial=0.0)) + error


def square_response(mixture: GaussianMixture, half_width: Real, held: Real) -> SquareResponse:
    """What squares of increasing ``half_width`` [mm] hold of the ``mixture``: as much as those of ``held`` [mm]."""
    order = np.argsort(mixture.variance)
    return SquareResponse(half_width, held, GaussianMixture(mixture.weight[order], mixture.variance[order]))
