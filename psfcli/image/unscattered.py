"""The unscattered light, exactly in pupil radius: PSF_G integrated over pixels and boxes without ray noise.

Along one pupil azimuth the landing point is a cubic in rho. Its crossings with the edges of the cells cut the radius
into pieces that land in one cell each, of power proportional to the difference of rho^2. No density is needed, so a
perfect image, a line focus and a caustic are as good as any. The sum over azimuths is a midpoint rule, whose error
falls like N^-3/2 to N^-2; the change at the last tripling tells how far it has fallen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import azimuth_rule, ray_fans
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_NEWTON_STEPS = 60
_FIRST_AZIMUTHS = 60  # a multiple of 4, so that slices end where fans jump from one side of an edge to the other
_MOST_AZIMUTHS = 60 * 3**7
_GAIN = 3.0**1.5 - 1.0  # the error left after tripling, as a share of the change, at the slower rate


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of the ray fans, each within one cell: power (a fraction of the unscattered light; all add to 1)

    and landing point of the middle [mm].
    """

    power: Real
    x: Real
    y: Real


def pieces_between(telescope: Telescope, field: Field, azimuths: int, edges_x: Real, edges_y: Real) -> Pieces:
    """The ray fans along ``azimuths`` azimuths cut at every crossing with x in ``edges_x`` and y in ``edges_y`` [mm].

    Edges must increase.
    """
    inner = telescope.pupil.obscuration
    fans_x, fans_y = ray_fans(telescope, field, azimuth_rule(telescope, field, azimuths))
    fan = [np.arange(azimuths), np.arange(azimuths)]
    rho = [np.full(azimuths, inner), np.ones(azimuths)]
    for fans, edges in ((fans_x, edges_x), (fans_y, edges_y)):
        crossing_fan, crossing_rho = _crossings(fans, inner, edges)
        fan.append(crossing_fan)
        rho.append(crossing_rho)
    all_fan, all_rho = np.concatenate(fan), np.concatenate(rho)
    order = np.lexsort((all_rho, all_fan))
    all_fan, all_rho = all_fan[order], all_rho[order]
    within = all_fan[1:] == all_fan[:-1]
    start, stop, which = all_rho[:-1][within], all_rho[1:][within], all_fan[1:][within]
    middle = 0.5 * (start + stop)
    return Pieces(
        power=(stop - start) * (stop + start) / ((1.0 - inner**2) * azimuths),
        x=_cubic(fans_x[:, which], middle),
        y=_cubic(fans_y[:, which], middle),
    )


def unscattered_on_grid(
    telescope: Telescope, field: Field, edges_x: Real, edges_y: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in the cells of a uniform grid, shape (y, x), and their estimated error.

    A piece on an edge, such as the whole of a perfect image on a pixel corner, is shared by both sides.
    """
    rows, columns = edges_y.size - 1, edges_x.size - 1

    def in_cells(pieces: Pieces) -> Real:
        cells = np.zeros(rows * columns)
        for column, column_share in _cells(pieces.x, edges_x):
            for row, row_share in _cells(pieces.y, edges_y):
                power = pieces.power * row_share * column_share
                inside = (power > 0.0) & (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
                cells += np.bincount(row[inside] * columns + column[inside], power[inside], cells.size)
        return cells

    cells, error = _settled(telescope, field, edges_x, edges_y, in_cells, tolerance)
    return cells.reshape(rows, columns), error


def unscattered_in_boxes(
    telescope: Telescope, field: Field, centre: tuple[float, float], half_width: Real, tolerance: float
) -> tuple[Real, float]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about ``centre``, same shape,

    and their estimated error.
    """

    def in_boxes(pieces: Pieces) -> Real:
        distance = np.maximum(np.abs(pieces.x - centre[0]), np.abs(pieces.y - centre[1]))
        level = np.searchsorted(half_width, distance)
        return np.cumsum(np.bincount(level, pieces.power, half_width.size + 1))[:-1]

    edges = np.concatenate([-half_width[::-1], half_width])
    boxes, error = _settled(telescope, field, centre[0] + edges, centre[1] + edges, in_boxes, tolerance)
    return np.minimum(boxes, 1.0), error


def _settled(
    telescope: Telescope,
    field: Field,
    edges_x: Real,
    edges_y: Real,
    gather: Callable[[Pieces], Real],
    tolerance: float,
) -> tuple[Real, float]:
    """What ``gather`` makes of the pieces, with azimuths tripled until the change promises ``tolerance``, and its error."""
    azimuths = _FIRST_AZIMUTHS
    coarse = gather(pieces_between(telescope, field, azimuths, edges_x, edges_y))
    while True:
        azimuths *= 3
        fine = gather(pieces_between(telescope, field, azimuths, edges_x, edges_y))
        error = float(np.max(np.abs(fine - coarse), initial=0.0)) / _GAIN
        if error <= tolerance or azimuths >= _MOST_AZIMUTHS:
            return fine, error
        coarse = fine


def _cells(position: Real, edges: Real) -> tuple[tuple[Index, Real], tuple[Index, Real]]:
    """The two candidate cells of each position with their shares: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    return (cell, np.where(on_edge, 0.5, 1.0)), (cell - 1, np.where(on_edge, 0.5, 0.0))


def _cubic(coefficients: Real, rho: Real) -> Real:
    a0, a1, a2, a3 = coefficients
    value: Real = ((a3 * rho + a2) * rho + a1) * rho + a0
    return value


def _crossings(fans: Real, inner: float, edges: Real) -> tuple[Index, Real]:
    """Every crossing of the cubics ``fans`` (4, azimuths) with the ``edges`` for inner < rho < 1: azimuth index, rho.

    Between its turning points a cubic is monotone and meets each edge in its range once.
    """
    turning = np.sort(_turning_points(fans, inner), axis=0)
    limits = np.concatenate([np.full((1, fans.shape[1]), inner), turning, np.ones((1, fans.shape[1]))])
    value = _cubic(fans[:, None, :], limits)
    low, high = np.minimum(value[1:], value[:-1]), np.maximum(value[1:], value[:-1])
    first = np.searchsorted(edges, low.ravel(), side="right")
    count = np.searchsorted(edges, high.ravel(), side="left") - first
    count = np.maximum(count, 0)
    branch = np.repeat(np.arange(count.size), count)
    edge = edges[np.arange(branch.size) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)]
    fan = branch % fans.shape[1]
    start, stop = limits[:-1].ravel()[branch], limits[1:].ravel()[branch]
    rising = (value[1:] > value[:-1]).ravel()[branch]
    return fan, _monotone_root(fans[:, fan], edge, start, stop, rising)


def _turning_points(fans: Real, inner: float) -> Real:
    """Zeros of the cubics' derivatives within (inner, 1), shape (2, azimuths); 1 where there is none."""
    _, c, b, a = fans * np.array([0.0, 1.0, 2.0, 3.0])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b * b - 4.0 * a * c), b))
        roots = np.stack([q / a, c / q])
        return np.where((roots > inner) & (roots < 1.0), roots, 1.0)


def _monotone_root(coefficients: Real, target: Real, start: Real, stop: Real, rising: NDArray[np.bool_]) -> Real:
    """The root of cubic = target within (start, stop), where the cubic is monotone: Newton's steps kept in a bracket."""
    low, high = start.copy(), stop.copy()
    rho = 0.5 * (low + high)
    a0, a1, a2, a3 = coefficients
    for _ in range(_NEWTON_STEPS):
        excess = ((a3 * rho + a2) * rho + a1) * rho + (a0 - target)
        below = (excess < 0.0) == rising
        low, high = np.where(below, rho, low), np.where(below, high, rho)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = excess / ((3.0 * a3 * rho + 2.0 * a2) * rho + a1)
        following = rho - step
        following = np.where((following > low) & (following < high), following, 0.5 * (low + high))
        moved = np.max(np.abs(following - rho), initial=0.0)
        rho = following
        if moved < 1e-14:
            break
    return rho
