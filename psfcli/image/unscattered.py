"""The unscattered light, PSF_G integrated over pixels, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth the light of a cell is smooth but for kinks, where a fan begins to meet
a corner of the cell, the rim or a fold, so slices are halved where they matter (quadrature.py). Lengths in mm.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import pieces_between
from psfcli.image.geometric import GeometricalImage, ray_fans
from psfcli.image.quadrature import integrate_adaptively

Real = NDArray[np.float64]
Index = NDArray[np.intp]
Assignment = tuple[Index, Real]  # cells of pieces (-1: none) and the part of each piece's share that lands there

_FEWEST_SLICES = 48
_FANS_AT_ONCE = 2048
_BUCKETS = 1021  # cells are told apart modulo this when slices are judged


def unscattered_on_grid(point: GeometricalImage, edges_x: Real, edges_y: Real, tolerance: float) -> tuple[Real, float]:
    """Fractions of the unscattered light in the cells of a uniform grid, shape (y, x), and their estimated error.

    A piece on an edge, such as the whole of a perfect image on a pixel corner, is shared by both sides.
    """
    rows, columns = edges_y.size - 1, edges_x.size - 1
    symmetric = point.mirror_symmetric and np.allclose(edges_x, -edges_x[::-1], rtol=0.0, atol=1e-12)

    def per_fan(azimuth: Real, modulus: int, power: Real | None = None) -> Real:
        """The light of each fan per cell modulo ``modulus``; with the ``power`` of each fan, their sum (1, modulus)."""
        fans = ray_fans(point.telescope, point.field, azimuth)
        pieces = pieces_between(*fans, point.telescope.pupil.obscuration, edges_x, edges_y)
        fan = pieces.fan if power is None else np.zeros_like(pieces.fan)
        share = pieces.share if power is None else pieces.share * power[pieces.fan]
        light = np.zeros((azimuth.size if power is None else 1) * modulus)
        for column, column_part in _cells(pieces.x, edges_x):
            for row, row_part in _cells(pieces.y, edges_y):
                amount = share * (row_part * column_part)
                lit = (amount > 0.0) & (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
                place = fan[lit] * modulus + (row[lit] * columns + column[lit]) % modulus
                light += np.bincount(place, amount[lit], light.size)
        return light.reshape(-1, modulus)

    start, stop = lit_azimuths(point, half=symmetric)
    if point.is_a_point:
        return per_fan(np.array([start]), rows * columns)[0].reshape(rows, columns), 0.0
    bounds = np.linspace(start, stop, slice_count(start, stop, tolerance) + 1)
    modulus = min(rows * columns, _BUCKETS)
    rule = integrate_adaptively(
        lambda azimuth, _: per_fan(azimuth, modulus),
        bounds[:-1],
        bounds[1:],
        np.zeros(bounds.size - 1, dtype=np.intp),
        np.array([tolerance * (stop - start)]),
    )
    if modulus == rows * columns:
        energy = rule.integral[0]
    else:
        energy = np.zeros(rows * columns)
        node, weight = rule.nodes(0)
        for first in range(0, node.size, _FANS_AT_ONCE):
            part = slice(first, first + _FANS_AT_ONCE)
            energy += per_fan(node[part], energy.size, weight[part])[0]
    grid = (energy / (stop - start)).reshape(rows, columns)
    return (0.5 * (grid + grid[:, ::-1]) if symmetric else grid), float(rule.error[0]) / (stop - start)


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
    return 4 * math.ceil(0.25 * max(_FEWEST_SLICES, 0.1 * (stop - start) / math.sqrt(tolerance)))


def _cells(position: Real, edges: Real) -> tuple[Assignment, Assignment]:
    """The two candidate cells of each position with their parts: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    return (cell, np.where(on_edge, 0.5, 1.0)), (cell - 1, np.where(on_edge, 0.5, 0.0))
