"""The unscattered light, PSF_G integrated over pixels, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth the light of a cell is smooth but for kinks, where a fan begins to meet
a corner of the cell, the rim or a fold, so slices are halved where they matter (quadrature.py). Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import pieces_between
from psfcli.image.geometric import GeometricalImage
from psfcli.image.quadrature import integrate_adaptively
from psfcli.telescope.aberration import transverse_aberration_along_azimuths
from psfcli.telescope.system import Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]
Assignment = tuple[Index, Real]  # cells of pieces (-1: none) and the part of each piece's share that lands there
Window = tuple[slice, slice]  # rows and columns of a grid

_FEWEST_SLICES = 20.0  # for each radian
_FANS_AT_ONCE = 512  # whose pieces a processor's cache holds
_SLICES_AT_ONCE = 384  # each of as many values as there are buckets
_BUCKETS = 1021  # cells are told apart modulo this when slices are judged


def unscattered_on_grid(point: GeometricalImage, edges_x: Real, edges_y: Real, tolerance: float) -> tuple[Real, float]:
    """Fractions of the unscattered light in the cells of a uniform grid, shape (y, x), and their estimated error.

    A piece on an edge, such as the whole of a perfect image on a pixel corner, is shared by both sides.
    """
    whole = slice(0, edges_y.size - 1), slice(0, edges_x.size - 1)
    return unscattered_in_windows([point], edges_x, edges_y, [whole], np.array([tolerance]))[0]


def unscattered_in_windows(
    points: Sequence[GeometricalImage], edges_x: Real, edges_y: Real, windows: Sequence[Window], tolerance: Real
) -> list[tuple[Real, float]]:
    """The same for each of the ``points`` in its own window of one uniform grid, within its ``tolerance`` (point,).

    All points are of one telescope: they are integrated together, which costs less than one by one and changes nothing.
    """
    if not points:
        return []
    landings = _Landings.of(points, edges_x, edges_y, windows)
    symmetric = [
        point.mirror_symmetric and np.allclose(own := edges_x[columns.start : columns.stop + 1], -own[::-1], 0.0, 1e-12)
        for point, (_, columns) in zip(points, windows, strict=True)
    ]
    bounds = np.array([lit_azimuths(point, half=half) for point, half in zip(points, symmetric, strict=True)])
    result = {n: (landings.of_one_fan(n, start), 0.0) for n, (start, _) in enumerate(bounds) if points[n].is_a_point}
    extended = np.array([n for n in range(len(points)) if n not in result], dtype=np.intp)
    if extended.size:
        start, stop = bounds[extended].T
        slices = [
            np.linspace(a, b, slice_count(a, b, t) + 1)
            for a, b, t in zip(start, stop, tolerance[extended], strict=True)
        ]
        modulus = np.minimum(landings.cells, _BUCKETS)
        rule = integrate_adaptively(
            lambda azimuth, group: landings.per_fan(azimuth, extended[group], modulus),
            np.concatenate([edges[:-1] for edges in slices]),
            np.concatenate([edges[1:] for edges in slices]),
            np.repeat(np.arange(extended.size), [edges.size - 1 for edges in slices]),
            tolerance[extended] * (stop - start),
            at_once=_SLICES_AT_ONCE,
        )
        for group, n in enumerate(extended.tolist()):
            known = landings.cells[n] == modulus[n]
            energy = rule.integral[group, : modulus[n]] if known else landings.summed(n, *rule.nodes(group))
            lit = float(stop[group] - start[group])
            grid = (energy / lit).reshape(landings.shape[n])
            result[n] = 0.5 * (grid + grid[:, ::-1]) if symmetric[n] else grid, float(rule.error[group]) / lit
    return [result[n] for n in range(len(points))]


@dataclass(frozen=True, slots=True)
class _Landings:
    """Where the fans of several points land on a grid, each seen in its own window.

    ``relative_field`` (point, 2); ``first`` and ``shape`` (point, 2) are the row and column at which a window begins,
    and how many it has.
    """

    telescope: Telescope
    relative_field: Real
    edges_x: Real
    edges_y: Real
    first: Index
    shape: Index

    @classmethod
    def of(
        cls, points: Sequence[GeometricalImage], edges_x: Real, edges_y: Real, windows: Sequence[Window]
    ) -> _Landings:
        """The landings of ``points`` of one telescope in their ``windows``."""
        telescope = points[0].telescope
        first, stop = (np.array([[getattr(p, end) for p in window] for window in windows]) for end in ("start", "stop"))
        (row, column), (last_row, last_column) = first.min(axis=0), stop.max(axis=0)  # of all windows together
        return cls(
            telescope,
            np.array([telescope.relative_field(point.field) for point in points]),
            edges_x[column : last_column + 1],
            edges_y[row : last_row + 1],
            first - (row, column),
            stop - first,
        )

    @property
    def cells(self) -> Index:
        """How many cells each window has."""
        return np.prod(self.shape, axis=1)

    def per_fan(self, azimuth: Real, point: Index, modulus: Index) -> Real:
        """The light of the fan along each ``azimuth`` of its ``point``, per cell modulo the point's ``modulus``."""
        light = np.empty((azimuth.size, int(modulus.max())))
        for part in _few_fans(azimuth.size):
            fan, cell, amount = self._amounts(azimuth[part], point[part])
            place = fan * light.shape[1] + cell % modulus[point[part][fan]]
            light[part] = np.bincount(place, amount, light[part].size).reshape(light[part].shape)
        return light

    def summed(self, point: int, azimuth: Real, power: Real) -> Real:
        """The light of fans of one ``point`` per cell, each times its ``power``."""
        light = np.zeros(self.cells[point])
        for part in _few_fans(azimuth.size):
            fan, cell, amount = self._amounts(azimuth[part], np.full(azimuth[part].size, point))
            light += np.bincount(cell, amount * power[part][fan], light.size)
        return light

    def of_one_fan(self, point: int, azimuth: float) -> Real:
        """The light of one fan, in the shape of the point's window."""
        return self.summed(point, np.array([azimuth]), np.ones(1)).reshape(self.shape[point])

    def _amounts(self, azimuth: Real, point: Index) -> tuple[Index, Index, Real]:
        """The light that lands: index of the fan, of the cell in its point's window, and share of the fan's light."""
        telescope = self.telescope
        fans = transverse_aberration_along_azimuths(
            telescope.seidel, tuple(self.relative_field[point].T), azimuth, telescope.image_slope
        )
        pieces = pieces_between(*fans, telescope.pupil.obscuration, self.edges_x, self.edges_y)
        of = point[pieces.fan]
        (first_row, first_column), (rows, columns) = self.first[of].T, self.shape[of].T
        found = []
        for column, column_part in _cells(pieces.x, self.edges_x):
            for row, row_part in _cells(pieces.y, self.edges_y):
                amount = pieces.share * (row_part * column_part)
                i, j = row - first_row, column - first_column
                lit = (amount > 0.0) & (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
                found.append((pieces.fan[lit], (i * columns + j)[lit], amount[lit]))
        fan, cell, share = (np.concatenate(some) for some in zip(*found, strict=True))
        return fan, cell, share


def _few_fans(count: int) -> Iterator[slice]:
    """All fans, a few at a time."""
    for start in range(0, count, _FANS_AT_ONCE):
        yield slice(start, start + _FANS_AT_ONCE)


def lit_azimuths(point: GeometricalImage, *, half: bool) -> tuple[float, float]:
    """The lit azimuths; of an image symmetric in x only those from pi/2 to 3 pi/2, which stand for the others."""
    if point.telescope.pupil.is_full_annulus:
        return 0.5 * math.pi, (1.5 if half else 2.5) * math.pi
    return point.telescope.pupil.sector


def slice_count(start: float, stop: float, tolerance: float) -> int:
    """Slices from ``start`` to ``stop`` so narrow that no fold that just touches an edge is missed by their fans.

    Such a fold, delta wide in azimuth, holds about delta^2/2. Four fans are seen of each slice. A multiple of 4: slices
    end where fans jump from one side of an edge to the other.
    """
    return 4 * math.ceil(0.25 * (stop - start) * max(_FEWEST_SLICES, 0.1 / math.sqrt(tolerance)))


def _cells(position: Real, edges: Real) -> Iterator[Assignment]:
    """The candidate cells of each position with their parts: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    yield cell, np.where(on_edge, 0.5, 1.0)
    if on_edge.any():
        yield cell - 1, np.where(on_edge, 0.5, 0.0)
