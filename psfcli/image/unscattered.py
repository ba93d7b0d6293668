"""The unscattered light, PSF_G integrated over pixels and boxes, as exact as asked.

Exact in pupil radius (crossings.py). In azimuth the light of a cell is smooth but for kinks, where a fan begins to meet
a corner of the cell, the rim or a fold, so slices are halved where they matter (quadrature.py). Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.crossings import light_in_squares, pieces_between
from psfcli.image.geometric import GeometricalImage, along_fans
from psfcli.image.quadrature import integrate_adaptively
from psfcli.telescope.aberration import transverse_aberration_along_azimuths

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
    if point.is_a_point:
        return per_fan(np.array([start]), rows * columns)[0].reshape(rows, columns), 0.0
    bounds = np.linspace(start, stop, _slice_count(start, stop, tolerance) + 1)
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
        for first in range(0, rule.node.size, _FANS_AT_ONCE):
            part = slice(first, first + _FANS_AT_ONCE)
            energy += per_fan(rule.node[part], energy.size, rule.weight[part])[0]
    grid = (energy / (stop - start)).reshape(rows, columns)
    return (0.5 * (grid + grid[:, ::-1]) if symmetric else grid), float(rule.error[0]) / (stop - start)


def unscattered_in_boxes(
    points: Sequence[GeometricalImage],
    centres: Sequence[Sequence[tuple[float, float]]],
    half_width: Real,
    tolerance: float,
) -> list[tuple[Real, float]]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about the ``centres`` of each of

    the ``points``, shape [centre, box], and their estimated error. All points are of one telescope: they are
    integrated together, which costs less than one by one.
    """
    about = [_About.of(point, centre) for point, some in zip(points, centres, strict=True) for centre in some]
    some = int(np.searchsorted(half_width, max(each.farthest for each in about)))  # boxes beyond hold all
    inside = np.ones((len(about), half_width.size))
    error = np.zeros(len(about))
    if some:
        place = np.array([each.centre for each in about])
        relative_field = np.array([each.relative_field for each in about])
        start, stop = np.array([each.azimuths for each in about]).T
        telescope = points[0].telescope
        pupil = telescope.pupil

        def fans(azimuth: Real, group: Index) -> tuple[Real, Real]:
            """The fans of each group along ``azimuth``, counted from the group's centre."""
            fans_x, fans_y = transverse_aberration_along_azimuths(
                telescope.seidel, tuple(relative_field[group].T), azimuth, telescope.image_slope
            )
            fans_x[0] -= place[group, 0]
            fans_y[0] -= place[group, 1]
            return fans_x, fans_y

        left, right, group = _slices_about(fans, pupil.obscuration, start, stop, tolerance)
        rule = integrate_adaptively(
            lambda azimuth, group: light_in_squares(*fans(azimuth, group), pupil.obscuration, half_width[:some]),
            left,
            right,
            group,
            tolerance * (stop - start),
        )
        inside[:, :some] = np.minimum(rule.integral / (stop - start)[:, None], 1.0)
        error = rule.error / (stop - start)
    ends = np.cumsum([len(some) for some in centres])
    return [
        (rows, float(errors.max()))
        for rows, errors in zip(np.split(inside, ends[:-1]), np.split(error, ends[:-1]), strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _About:
    """Boxes about one ``centre`` [mm] of one image: lit ``azimuths``, and a half width that holds the whole spot."""

    centre: tuple[float, float]
    relative_field: tuple[float, float]
    azimuths: tuple[float, float]
    farthest: float

    @classmethod
    def of(cls, point: GeometricalImage, centre: tuple[float, float]) -> _About:
        """The boxes about ``centre`` of ``point``."""
        spot, (x, y) = point.spot, centre
        return cls(
            centre,
            point.telescope.relative_field(point.field),
            _azimuths(point, half=point.mirror_symmetric and x == 0.0),
            1.01 * max(spot.x_max - x, x - spot.x_min, spot.y_max - y, y - spot.y_min),
        )


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
    fans: Callable[[Real, Index], tuple[Real, Real]], inner: float, start: Real, stop: Real, tolerance: float
) -> tuple[Real, Real, Index]:
    """First slices (left, right, group) for boxes about the origin of each group, where they shrink to nothing.

    Slices whose fans pass at a distance d are no wider there than d, down to boxes that hold less than the tolerance.
    """
    counts = [_slice_count(a, b, tolerance) for a, b in zip(start, stop, strict=True)]
    bound = np.concatenate([np.linspace(a, b, n + 1) for a, b, n in zip(start, stop, counts, strict=True)])
    group = np.repeat(np.arange(start.size), np.array(counts) + 1)
    rho = np.linspace(inner, 1.0, 33)
    while True:
        fans_x, fans_y = fans(bound, group)
        x, y = along_fans(fans_x, rho), along_fans(fans_y, rho)
        distance = _length(x, y)
        hop = _length(x[1:] - x[:-1], y[1:] - y[:-1])
        # the fan may come closer between two of its points, by half the way from one to the next
        closest = distance.copy()
        closest[:-1] -= 0.5 * hop
        np.minimum(closest[1:], distance[1:] - 0.5 * hop, out=closest[1:])
        farthest = np.zeros(start.size)
        np.maximum.at(farthest, group, distance.max(axis=0))
        closest = np.maximum(closest, math.sqrt(tolerance) * farthest[group])
        width = _length(x[:, 1:] - x[:, :-1], y[:, 1:] - y[:, :-1])
        slices = np.flatnonzero(group[1:] == group[:-1])
        split = slices[np.any(width > 2.0 * np.maximum(closest[:, 1:], closest[:, :-1]), axis=0)[slices]]
        if split.size == 0 or bound.size > _MOST_FIRST_SLICES * start.size:
            return bound[slices], bound[slices + 1], group[slices]
        middle = 0.5 * (bound[split] + bound[split + 1])
        bound, group = np.insert(bound, split + 1, middle), np.insert(group, split + 1, group[split])


def _length(x: Real, y: Real) -> Real:
    """What hypot gives, faster, where squares neither overflow nor matter when they vanish."""
    length: Real = np.sqrt(x * x + y * y)
    return length


def _cells(position: Real, edges: Real) -> tuple[Assignment, Assignment]:
    """The two candidate cells of each position with their parts: all in one, or half and half on an edge."""
    coordinate = (position - edges[0]) / (edges[-1] - edges[0]) * (edges.size - 1)
    nearest = np.rint(coordinate)
    on_edge = np.abs(coordinate - nearest) < 1e-9
    cell = np.where(on_edge, nearest, np.floor(coordinate)).astype(np.intp)
    return (cell, np.where(on_edge, 0.5, 1.0)), (cell - 1, np.where(on_edge, 0.5, 0.0))
