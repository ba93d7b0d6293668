"""The image of a point by convolution against rays counted in its cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from psfcli.config.model import System
from psfcli.montecarlo.cells import CellGrid, cell_counts
from psfcli.montecarlo.third_order import ThirdOrderRays
from psfcli.validation.comparison import FALSE_ALARM

Real = NDArray[np.float64]

_FEW = 25.0  # rays expected in a cell; below, the square of the difference is not chi-squared


@dataclass(frozen=True, slots=True)
class CellComparison:
    """One image on cells [y, x]: the fraction of light in each by ``convolution`` and by ``rays`` of Monte Carlo."""

    convolution: Real
    montecarlo: Real
    rays: int

    @property
    def _judged(self) -> NDArray[np.bool_]:
        return self.rays * self.convolution >= _FEW

    @property
    def cells(self) -> int:
        """How many cells have enough rays to be judged."""
        return int(self._judged.sum())

    @property
    def chi_squared(self) -> float:
        """Sum of (N - N p)^2/(N p) over the cells judged: as many as they are, or fewer by quasi-random rays."""
        p, q = self.convolution[self._judged], self.montecarlo[self._judged]
        return float(np.sum((q - p) ** 2 / p) * self.rays)

    @property
    def rms_difference(self) -> float:
        """Root mean square of the relative differences of the cells judged [1]."""
        p, q = self.convolution[self._judged], self.montecarlo[self._judged]
        return float(np.sqrt(np.mean((q / p - 1.0) ** 2))) if p.size else 0.0

    @property
    def explained(self) -> bool:
        """Whether chance explains the differences: as large ones in more than FALSE_ALARM of all comparisons."""
        return bool(stats.chi2.sf(self.chi_squared, max(self.cells, 1)) > FALSE_ALARM)


def compare_cells(
    systems: list[System], images: list[Real], count: int, *, seed: int = 0, jobs: int = 1
) -> list[CellComparison]:
    """The ``images`` [y, x] of several windows on one scene against the same rays of third-order geometry.

    The ``systems`` differ in their detectors alone; each image is of the sub-pixels of its own, of the first field and
    wavelength.
    """
    first = systems[0]
    rays = ThirdOrderRays(first.telescope, first.surfaces, first.wavelengths[0], first.fields[0])
    grids = [
        CellGrid(detector.start(0), detector.start(1), detector.sub_pixel, detector.sub_pixels)
        for detector in (system.detector for system in systems)
    ]
    traced, counts = cell_counts(rays, grids, count, seed=(seed,), jobs=jobs)
    return [CellComparison(image, counted / traced, traced) for image, counted in zip(images, counts, strict=True)]
