"""Rays counted in the cells of a detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from psfcli.montecarlo.estimate import BATCHES, Rays, batch_size, batches, chance

Real = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CellGrid:
    """A square of ``number`` x ``number`` cells, each ``width`` wide, from (``x_start``, ``y_start``) on [mm]."""

    x_start: float
    y_start: float
    width: float
    number: int

    def counts(self, x: Real, y: Real) -> Whole:
        """How many of the points (x, y) [mm] lie in each cell, shape [y, x], its lower edges included."""
        column, row = (x - self.x_start) / self.width, (y - self.y_start) / self.width
        within = (column >= 0.0) & (column < self.number) & (row >= 0.0) & (row < self.number)
        cell = row[within].astype(np.int64) * self.number + column[within].astype(np.int64)
        return np.bincount(cell, minlength=self.number**2).reshape(self.number, self.number)


def cell_counts(
    rays: Rays, grids: Sequence[CellGrid], count: int, *, seed: tuple[int, ...], jobs: int = 1
) -> tuple[int, list[Whole]]:
    """The number of rays, ``count`` or a few more, and how many land in each cell of each of ``grids``, [y, x].

    Divided by the number, the counts are fractions of all light; what lands elsewhere or is lost is in no cell. They
    are the same for the same ``seed`` by any number of ``jobs``.
    """
    size = batch_size(count)
    parts = batches(partial(_batch, rays, tuple(grids), size, seed), jobs)
    return size * BATCHES, [sum(counts) for counts in zip(*parts, strict=True)]


def _batch(rays: Rays, grids: tuple[CellGrid, ...], size: int, seed: tuple[int, ...], number: int) -> list[Whole]:
    counts = [np.zeros((grid.number, grid.number), dtype=np.int64) for grid in grids]
    for x, y in rays.landings(chance(seed, number), size):
        for grid, counted in zip(grids, counts, strict=True):
            counted += grid.counts(x, y)
    return counts
