"""The unscattered light, PSF_G integrated over pixels and boxes, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth the light of a cell is smooth but for kinks, where a fan begins to meet
a corner of the cell, the rim or a fold, so slices are halved where they matter (quadrature.py). Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import Pieces, pieces_between
from psfcli.image.geometric import GeometricalImage, along_fans, ray_fans
from psfcli.image.quadrature import integrate_adaptively

Real = NDArray[np.float64]
Index = NDArray[np.intp]
Assignment = tuple[Index, Real]  # cells of pieces (-1: none) and the part of each piece's share that lands there

_FEWEST_SLICES = 16  # a multiple of 4: slices end where fans jump from one side of an edge to the other
_MOST_FIRST_SLICES = 10_000
_FANS_AT_ONCE = 2048
_BUCKETS = 1021  # cells are told apart modulo this when slices are judged


def unscattered_on_grid(
    point: GeometricalImage, edges_x: Real, edges_y: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in the cells of a uniform grid, shape (y, x), and their estimated error.

    A piece on an edge, such as the whole of a perfect image on a pixel corner, is shared by both sides.
    """
    rows, columns = edges_y.size - 1, edges_x.size - 1

    def cells(pieces: Pieces) -> list[Assignment]:
        return [
            (
                np.where(
                    (row >= 0) & (row < rows) & (column >= 0) & (column < columns), row * columns + column, -1
                ),
                row_part * column_part,
            )
            for column, column_part in _cells(pieces.x, edges_x)
            for row, row_part in _cells(pieces.y, edges_y)
        ]

    symmetric = point.mirror_symmetric and np.allclose(edges_x, -edges_x[::-1], rtol=0.0, atol=1e-12)
    energy, error = _integrated(point, edges_x, edges_y, cells, rows * columns, tolerance, half=symmetric)
    grid = energy.reshape(rows, columns)
    return (0.5 * (grid + grid[:, ::-1]) if symmetric else grid), error


def unscattered_in_boxes(
    point: GeometricalImage, centre: tuple[float, float], half_width: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about ``centre``, same shape,

    and their estimated error.
    """

    def rings(pieces: Pieces) -> list[Assignment]:
        distance = np.maximum(np.abs(pieces.x - centre[0]), np.abs(pieces.y - centre[1]))
        return [(np.searchsorted(half_width, distance), np.ones_like(distance))]

    edges = np.concatenate([-half_width[::-1], half_width])
    symmetric = point.mirror_symmetric and centre[0] == 0.0
    energy, error = _integrated(
        point,
        centre[0] + edges,
        centre[1] + edges,
        rings,
        half_width.size + 1,
        tolerance,
        half=symmetric,
        common_centre=centre,
    )
    return np.minimum(energy[:-1], 1.0), error


def _integrated(
    point: GeometricalImage,
    edges_x: Real,
    edges_y: Real,
    assign: Callable[[Pieces], list[Assignment]],
    cells: int,
    tolerance: float,
    *,
    half: bool,
    common_centre: tuple[float, float] | None = None,
) -> tuple[Real, float]:
    """The light in each cell, shape (cells,), integrated over azimuth until ``tolerance`` is met, and its error.

    ``half``: only the azimuths from pi/2 to 3 pi/2, which stand for the others. With a ``common_centre`` the cells are
    nested rings about it, few enough to be told apart, and what is integrated is the running sum over them.
    """

    def gathered(azimuth: Real, modulus: int) -> Real:
        """The light of each fan per cell modulo ``modulus``, shape (azimuths, modulus)."""
        pieces = pieces_between(point.telescope, point.field, azimuth, edges_x, edges_y)
        light = np.zeros(azimuth.size * modulus)
        for cell, part in assign(pieces):
            lit = (cell >= 0) & (part > 0.0)
            place = pieces.fan[lit] * modulus + cell[lit] % modulus
            light += np.bincount(place, pieces.share[lit] * part[lit], light.size)
        return light.reshape(azimuth.size, modulus)

    def judged(azimuth: Real) -> Real:
        if common_centre is None:
            return gathered(azimuth, min(cells, _BUCKETS))
        return np.cumsum(gathered(azimuth, cells), axis=1)

    bounds = _first_slices(point, tolerance, half, common_centre)
    rule = integrate_adaptively(judged, bounds, tolerance * (bounds[-1] - bounds[0]))
    total = float(bounds[-1] - bounds[0])
    if common_centre is not None or cells <= _BUCKETS:
        return rule.integral / total, rule.error / total
    energy = np.zeros(cells)
    for first in range(0, rule.node.size, _FANS_AT_ONCE):
        part = slice(first, first + _FANS_AT_ONCE)
        pieces = pieces_between(point.telescope, point.field, rule.node[part], edges_x, edges_y)
        power = pieces.share * rule.weight[part][pieces.fan] / total
        for cell, piece_part in assign(pieces):
            lit = cell >= 0
            energy += np.bincount(cell[lit], power[lit] * piece_part[lit], cells)
    return energy, rule.error / total


def _first_slices(
    point: GeometricalImage, tolerance: float, half: bool, common_centre: tuple[float, float] | None
) -> Real:
    """Bounds of slices narrow enough that no feature worth ``tolerance`` falls between their fans.

    A fold of the image that just touches an edge, delta wide in azimuth, holds of the order of delta^2. Boxes about
    a centre shrink to nothing there, so slices whose fans pass at a distance d are no wider than d, down to boxes that
    hold less than the tolerance themselves.
    """
    telescope, field = point.telescope, point.field
    start, stop = telescope.pupil.sector
    if telescope.pupil.is_full_annulus:
        start, stop = 0.5 * math.pi, (1.5 if half else 2.5) * math.pi
    bounds = np.linspace(start, stop, 1 + 4 * math.ceil(0.25 * max(_FEWEST_SLICES, 0.1 / math.sqrt(tolerance))))
    if common_centre is None:
        return bounds
    rho = np.linspace(telescope.pupil.obscuration, 1.0, 33)
    while True:
        fans_x, fans_y = ray_fans(telescope, field, bounds)
        x, y = along_fans(fans_x, rho) - common_centre[0], along_fans(fans_y, rho) - common_centre[1]
        distance = np.hypot(x, y)
        hop = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0)).max(axis=0)
        near = np.maximum(distance.min(axis=0) - 0.5 * hop, math.sqrt(tolerance) * distance.max())
        width = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)).max(axis=0)
        split = width > 2.0 * np.maximum(near[1:], near[:-1])
        if not split.any() or bounds.size > _MOST_FIRST_SLICES:
            return bounds
        bounds = np.sort(np.append(bounds, 0.5 * (bounds[:-1] + bounds[1:])[split]))


def _cells(position: Real, edges: Real) -> tuple[Assignment, Assignment]:
    """The two candidate cells of each position with their parts: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    return (cell, np.where(on_edge, 0.5, 1.0)), (cell - 1, np.where(on_edge, 0.5, 0.0))
