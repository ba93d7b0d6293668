"""The unscattered light, PSF_G integrated over pixels and boxes, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth the light of a cell is smooth but for kinks, where a fan begins to meet
a corner of the cell, the rim or a fold, so slices are halved where they matter (quadrature.py). Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import light_in_squares, pieces_between
from psfcli.image.geometric import GeometricalImage, along_fans, ray_fans
from psfcli.image.quadrature import integrate_adaptively

Real = NDArray[np.float64]
Index = NDArray[np.intp]
Assignment = tuple[Index, Real]  # cells of pieces (-1: none) and the part of each piece's share that lands there

_FEWEST_SLICES = 48
_MOST_FIRST_SLICES = 10_000
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
        pieces = pieces_between(point.telescope, point.field, azimuth, edges_x, edges_y)
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

    start, stop = _azimuths(point, half=symmetric)
    bounds = np.linspace(start, stop, _slice_count(start, stop, tolerance) + 1)
    modulus = min(rows * columns, _BUCKETS)
    rule = integrate_adaptively(
        lambda azimuth, _: per_fan(azimuth, modulus),
        bounds[:-1],
        bounds[1:],
        np.zeros(bounds.size - 1, dtype=np.intp),
        tolerance * (stop - start),
    )
    if modulus == rows * columns:
        energy = rule.integral[0]
    else:
        energy = np.zeros(rows * columns)
        for first in range(0, rule.node.size, _FANS_AT_ONCE):
            part = slice(first, first + _FANS_AT_ONCE)
            energy += per_fan(rule.node[part], energy.size, rule.weight[part])[0]
    grid = (energy / (stop - start)).reshape(rows, columns)
    return (0.5 * (grid + grid[:, ::-1]) if symmetric else grid), float(rule.error[0]) / (stop - start)


def unscattered_in_boxes(
    point: GeometricalImage, centres: Sequence[tuple[float, float]], half_width: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about each of the ``centres``,

    shape [centre, box], and their estimated error.
    """
    place = np.array(centres)
    inside = np.ones((len(centres), half_width.size))
    some = int(np.searchsorted(half_width, _farthest(point, place)))  # boxes beyond hold all
    half_width = half_width[:some]
    if some == 0:
        return inside, 0.0
    symmetric = point.mirror_symmetric and not np.any(place[:, 0])
    start, stop = _azimuths(point, half=symmetric)

    def energy(azimuth: Real, centre: Index) -> Real:
        """The light of each fan within each box about its centre, shape (azimuths, boxes)."""
        fans_x, fans_y = ray_fans(point.telescope, point.field, azimuth)
        fans_x[0] -= place[centre, 0]
        fans_y[0] -= place[centre, 1]
        return light_in_squares(fans_x, fans_y, point.telescope.pupil.obscuration, half_width)

    bounds = [_slices_about(point, (float(x), float(y)), start, stop, tolerance) for x, y in place]
    rule = integrate_adaptively(
        energy,
        np.concatenate([b[:-1] for b in bounds]),
        np.concatenate([b[1:] for b in bounds]),
        np.repeat(np.arange(len(centres)), [b.size - 1 for b in bounds]),
        tolerance * (stop - start),
    )
    inside[:, :some] = np.minimum(rule.integral / (stop - start), 1.0)
    return inside, float(rule.error.max()) / (stop - start)


def _farthest(point: GeometricalImage, centres: Real) -> float:
    """A half width [mm] at which boxes about any of the ``centres`` hold the whole spot."""
    spot = point.spot
    reach_x = np.maximum(spot.x_max - centres[:, 0], centres[:, 0] - spot.x_min)
    reach_y = np.maximum(spot.y_max - centres[:, 1], centres[:, 1] - spot.y_min)
    return 1.01 * float(np.maximum(reach_x, reach_y).max())


def _azimuths(point: GeometricalImage, *, half: bool) -> tuple[float, float]:
    """The lit azimuths; of an image symmetric in x only those from pi/2 to 3 pi/2, which stand for the others."""
    if point.telescope.pupil.is_full_annulus:
        return 0.5 * math.pi, (1.5 if half else 2.5) * math.pi
    return point.telescope.pupil.sector


def _slice_count(start: float, stop: float, tolerance: float) -> int:
    """Slices from ``start`` to ``stop`` so narrow that no fold that just touches an edge is missed by their fans.

    Such a fold, delta wide in azimuth, holds about delta^2/2. Four fans are seen of each slice. A multiple of 4: slices
    end where fans jump from one side of an edge to the other.
    """
    return 4 * math.ceil(0.25 * max(_FEWEST_SLICES, 0.1 * (stop - start) / math.sqrt(tolerance)))


def _slices_about(
    point: GeometricalImage, centre: tuple[float, float], start: float, stop: float, tolerance: float
) -> Real:
    """Bounds of slices for boxes about a ``centre``, where they shrink to nothing.

    Slices whose fans pass at a distance d are no wider there than d, down to boxes that hold less than the tolerance.
    """
    bounds = np.linspace(start, stop, _slice_count(start, stop, tolerance) + 1)
    rho = np.linspace(point.telescope.pupil.obscuration, 1.0, 65)
    while True:
        fans_x, fans_y = ray_fans(point.telescope, point.field, bounds)
        x, y = along_fans(fans_x, rho) - centre[0], along_fans(fans_y, rho) - centre[1]
        distance = np.hypot(x, y)
        hop = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0))
        # the fan may come closer between two of its points, by half the way from one to the next
        closest = distance - 0.5 * np.maximum(np.vstack([hop, hop[-1]]), np.vstack([hop[0], hop]))
        closest = np.maximum(closest, math.sqrt(tolerance) * distance.max())
        width = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1))
        split = np.any(width > 2.0 * np.maximum(closest[:, 1:], closest[:, :-1]), axis=0)
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
