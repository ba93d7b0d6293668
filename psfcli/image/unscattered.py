"""The unscattered light, PSF_G integrated over pixels and boxes, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth each slice is integrated by Gauss's three-point rule and split in halves
wherever the halves disagree: kinks, where a fan begins to meet a corner of a cell or the rim, are narrowed down, smooth
stretches are left alone. What the last splits changed tells the error. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import Pieces, pieces_between
from psfcli.image.geometric import along_fans, ray_fans
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]
Assignment = tuple[Index, Real]  # cells of pieces (-1: none) and the part of each piece's share that lands there

_FIRST_SLICES = 16  # a multiple of 4: slices end where fans jump from one side of an edge to the other
_MOST_FANS = 1_000_000
_SLICES_AT_ONCE = 512
_BUCKETS = 1021  # cells are told apart modulo this when slices are judged
_GAIN = 2.0  # a kink's error falls by 2^(3/2) to 4 from a slice to its halves; what is left, as a share of the change
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(3)


def unscattered_on_grid(
    telescope: Telescope, field: Field, edges_x: Real, edges_y: Real, tolerance: float
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

    symmetric = _mirror_symmetric(telescope, field) and np.allclose(edges_x, -edges_x[::-1], rtol=0.0, atol=1e-12)
    energy, error = _integrated(telescope, field, edges_x, edges_y, cells, rows * columns, tolerance, half=symmetric)
    grid = energy.reshape(rows, columns)
    return (0.5 * (grid + grid[:, ::-1]) if symmetric else grid), error


def unscattered_in_boxes(
    telescope: Telescope, field: Field, centre: tuple[float, float], half_width: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about ``centre``, same shape,

    and their estimated error.
    """

    def rings(pieces: Pieces) -> list[Assignment]:
        distance = np.maximum(np.abs(pieces.x - centre[0]), np.abs(pieces.y - centre[1]))
        return [(np.searchsorted(half_width, distance), np.ones_like(distance))]

    edges = np.concatenate([-half_width[::-1], half_width])
    symmetric = _mirror_symmetric(telescope, field) and centre[0] == 0.0
    energy, error = _integrated(
        telescope,
        field,
        centre[0] + edges,
        centre[1] + edges,
        rings,
        half_width.size + 1,
        tolerance,
        half=symmetric,
        common_centre=centre,
    )
    return np.minimum(np.cumsum(energy)[:-1], 1.0), error


def _mirror_symmetric(telescope: Telescope, field: Field) -> bool:
    """Whether the image is symmetric in x: the whole annulus is lit and the field lies along y."""
    return telescope.pupil.is_full_annulus and telescope.relative_field(field)[0] == 0.0


def _integrated(
    telescope: Telescope,
    field: Field,
    edges_x: Real,
    edges_y: Real,
    assign: Callable[[Pieces], list[Assignment]],
    cells: int,
    tolerance: float,
    *,
    half: bool,
    common_centre: tuple[float, float] | None = None,
) -> tuple[Real, float]:
    """The light in each cell, shape (cells,), summed over azimuth slices until ``tolerance`` is met, and its error.

    ``half``: only the azimuths from pi/2 to 3 pi/2, which stand for the others. With a ``common_centre`` the cells are
    nested rings about it, and the error counts for the running sum over them.
    """
    left, width = _first_slices(telescope, field, tolerance, half, common_centre)
    total = float(width.sum())
    buckets = min(cells, _BUCKETS)
    cumulative = common_centre is not None

    def integrate(left: Real, width: Real) -> tuple[list[tuple[Index, Index, Real]], Real]:
        """Per slice: (slice, cell, power) of its pieces, and the power per bucket, shape (slices, buckets)."""
        azimuth = (left + width * (0.5 + 0.5 * _NODE[:, None])).ravel()
        power = (0.5 * _WEIGHT[:, None] * width / total).ravel()
        pieces = pieces_between(telescope, field, azimuth, edges_x, edges_y)
        deposits = []
        judged = np.zeros(left.size * buckets)
        for cell, part in assign(pieces):
            lit = (cell >= 0) & (part > 0.0)
            fan = pieces.fan[lit]
            amount = pieces.share[lit] * part[lit] * power[fan]
            piece_slice = fan % left.size
            deposits.append((piece_slice, cell[lit], amount))
            judged += np.bincount(piece_slice * buckets + cell[lit] % buckets, amount, judged.size)
        return deposits, judged.reshape(left.size, buckets)

    energy = np.zeros(cells)
    doubt = np.zeros(buckets)
    coarse = integrate(left, width)[1]
    fans = 3 * left.size
    while left.size:
        later_left, later_width, later_coarse = [], [], []
        for first in range(0, left.size, _SLICES_AT_ONCE):
            part = slice(first, first + _SLICES_AT_ONCE)
            halves_width = np.repeat(0.5 * width[part], 2)
            halves_left = np.repeat(left[part], 2)
            halves_left[1::2] += halves_width[1::2]
            deposits, fine = integrate(halves_left, halves_width)
            change = np.abs(_running(fine[0::2] + fine[1::2] - coarse[part], cumulative))
            settled = change.max(axis=1) <= tolerance * _share_of_slice(width[part], total)
            if fans > _MOST_FANS:
                settled[:] = True
            doubt += change[settled].sum(axis=0)
            keep = np.repeat(settled, 2)
            for which, cell, amount in deposits:
                kept = keep[which]
                energy += np.bincount(cell[kept], amount[kept], cells)
            later_left.append(halves_left[~keep])
            later_width.append(halves_width[~keep])
            later_coarse.append(fine[~keep])
            fans += 6 * int(np.count_nonzero(~settled))
        left, width, coarse = (np.concatenate(parts) for parts in (later_left, later_width, later_coarse))
    return energy, float(doubt.max()) / _GAIN


def _first_slices(
    telescope: Telescope, field: Field, tolerance: float, half: bool, common_centre: tuple[float, float] | None
) -> tuple[Real, Real]:
    """Left ends and widths of slices narrow enough that no feature worth ``tolerance`` falls between their fans.

    A cap cut off at the rim, delta wide in azimuth, holds of the order of delta^3. Boxes about a centre shrink to
    nothing there, so slices whose fans pass at a distance d are no wider than a good part of d, down to boxes that
    hold less than the tolerance themselves.
    """
    start, stop = telescope.pupil.sector
    if telescope.pupil.is_full_annulus:
        start, stop = 0.5 * math.pi, (1.5 if half else 2.5) * math.pi
    count = 4 * math.ceil(max(_FIRST_SLICES, 0.5 * tolerance ** (-1.0 / 3.0)) / 4.0)
    width = np.full(count, (stop - start) / count)
    left = start + width * np.arange(count)
    if common_centre is None:
        return left, width
    rho = np.linspace(telescope.pupil.obscuration, 1.0, 33)
    while True:
        fans_x, fans_y = ray_fans(telescope, field, np.append(left, stop))
        x, y = along_fans(fans_x, rho) - common_centre[0], along_fans(fans_y, rho) - common_centre[1]
        distance = np.hypot(x, y)
        between = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1))
        hop = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0)).max(axis=0)
        near = np.maximum(distance.min(axis=0) - 0.5 * hop, math.sqrt(tolerance) * distance.max())
        split = between.max(axis=0) > np.maximum(near[1:], near[:-1])
        split &= left.size < _MOST_FANS // 100
        if not split.any():
            return left, width
        pieces = np.where(split, 2, 1)
        width = np.repeat(width / pieces, pieces)
        left = np.append(start, start + np.cumsum(width)[:-1])


def _running(change: Real, cumulative: bool) -> Real:
    return np.cumsum(change, axis=1) if cumulative else change


def _share_of_slice(width: Real, total: float) -> Real:
    """The share of the tolerance a slice may use: few slices hold a kink of any one cell, many are smooth."""
    return np.maximum(width / total, 0.02)


def _cells(position: Real, edges: Real) -> tuple[Assignment, Assignment]:
    """The two candidate cells of each position with their parts: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    return (cell, np.where(on_edge, 0.5, 1.0)), (cell - 1, np.where(on_edge, 0.5, 0.0))
