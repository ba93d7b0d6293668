"""The composite image of Eq. 44 on the detector's grid: exp(-G) PSF_G + PSF_G (x) S, integrated over sub-pixels [mm].

Nothing is sampled and nothing wraps around: a Gaussian integrated over a grid is an outer product of differences of
erf, so the window is a sum of products of thin matrices, each term on the block of cells it can be seen in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import interval_integrals, moment_orders, moments_to
from psfcli.image.geometric import GeometricalImage
from psfcli.image.grid import Detector
from psfcli.image.narrow_cells import add_narrow, cells_between
from psfcli.image.patches import rays_around
from psfcli.image.result import Spot
from psfcli.image.scatter import Halo
from psfcli.image.unscattered import Window, unscattered_in_windows
from psfcli.surface.mixture import GaussianMixture
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_LEVEL = 2.6  # successive blocks of cells shrink by this factor
_LEAST_WEIGHT = 1e-300
_SMALLEST_BLOCK = 24  # cells: smaller blocks cost more in calls than they save


@dataclass(frozen=True, slots=True)
class CompositeImage:
    """``light`` in each sub-pixel as a fraction of all, shape (y, x).

    ``unscattered``, PSF_G in the sub-pixels of ``rows`` and ``columns``, and the estimated ``error`` of it and of
    Gaussians too narrow for moments in the worst sub-pixel, as a fraction of all light. ``unresolved``: the relative
    error of dark pixels from Gaussians so narrow that the spot would take more rays than are taken. ``around``: rows
    and columns, in sub-pixels (2, ray), where some rays land outside the window, among them those within a pixel of it;
    ``beside``: their share of all light, no less than what lands within a pixel.
    """

    light: Real
    unscattered: Real
    rows: slice
    columns: slice
    error: float
    unresolved: float
    around: Real
    beside: float

    def unscattered_in(self, y: Index, x: Index, oversample: int = 1) -> Real:
        """PSF_G in pixels (y, x) of ``oversample`` sub-pixels a side, shape of both."""
        starts = self.rows.start, self.columns.start
        # to whole pixels, and a dark one on every side stands for all beyond
        pad = [
            (oversample + start % oversample, oversample + -(start + size) % oversample)
            for start, size in zip(starts, self.unscattered.shape, strict=True)
        ]
        fine = np.pad(self.unscattered, pad)
        light = fine.reshape(fine.shape[0] // oversample, oversample, -1, oversample).sum(axis=(1, 3))
        row, column = (
            np.clip(place - start // oversample + 1, 0, size - 1)
            for place, start, size in zip((y, x), starts, light.shape, strict=True)
        )
        value: Real = light[row, column]
        return value

    def touched(self, y: Index, x: Index, oversample: int = 1) -> NDArray[np.bool_]:
        """Whether unscattered light touches pixels (y, x) of so many sub-pixels or one of their eight neighbours."""
        i, j = np.mgrid[-1:2, -1:2].reshape(2, -1, 1)
        brightest: Real = self.unscattered_in(y + i, x + j, oversample).max(axis=0)
        beside = np.floor(self.around / oversample)[..., None]
        near = (np.abs(beside[0] - y) <= 1) & (np.abs(beside[1] - x) <= 1)
        return (brightest > 0.0) | near.any(axis=0)


def composite_images(
    points: Sequence[GeometricalImage], halo: Halo, detector: Detector, tolerance: Tolerance
) -> Iterator[CompositeImage]:
    """Eq. 44 on the detector's sub-pixels for each of the ``points``, with the errors that contract section 4 allows.

    Relative error within ``tolerance.pixel`` at every distance, energy within ``tolerance.ee``; where unscattered light
    touches, ``tolerance.ee`` of all light more. Gaussians too narrow to be told from no blur at all within these are
    added to the unscattered light.
    """
    orders = [moment_orders(point, halo.mixture, tolerance) for point in points]
    windows = [_touched_window(point, detector) for point in points]
    allowed = [
        _unscattered_error(halo, float(halo.mixture.weight[order < 0].sum()), window, tolerance)
        for order, window in zip(orders, windows, strict=True)
    ]
    lit = [n for n, (rows, columns) in enumerate(windows) if rows.stop > rows.start and columns.stop > columns.start]
    lit = [n for n in lit if allowed[n] < math.inf]
    found = unscattered_in_windows(
        [points[n] for n in lit],
        detector.edges(0),
        detector.edges(1),
        [windows[n] for n in lit],
        np.array([allowed[n] for n in lit]),
    )
    unscattered = dict(zip(lit, found, strict=True))
    for n, (point, order, window) in enumerate(zip(points, orders, windows, strict=True)):
        dark = np.zeros([max(part.stop - part.start, 0) for part in window]), 0.0
        yield _composite_image(point, order, window, *unscattered.pop(n, dark), halo, detector, tolerance)


def _unscattered_error(halo: Halo, narrow: float, window: Window, tolerance: Tolerance) -> float:
    """What PSF_G may err by in each sub-pixel of a ``window``; infinite where nothing is to be seen of it.

    It comes with the unscattered weight, and with what of ``narrow``, the weight of all Gaussians that moments do not
    blur, cannot be told from no blur: by ``narrow_error`` that sends the brightest sub-pixel no more than a tenth of
    ``tolerance.ee``, and so errs by less where sub-pixels of mean light are told from dark ones.
    """
    weight, share = halo.unscattered_weight, 0.3 * tolerance.ee
    if weight + narrow == 0.0:
        return math.inf
    cells = math.prod(max(part.stop - part.start, 1) for part in window)
    return max(share / (weight + narrow), min(share / max(weight, _LEAST_WEIGHT), 1.0 / cells))


def _touched_window(point: GeometricalImage, detector: Detector) -> Window:
    """The sub-pixels that unscattered light touches, and one more on either side."""
    spot = point.spot
    rows = cells_between(detector.edges(1), spot.y_min, spot.y_max)
    return rows, cells_between(detector.edges(0), spot.x_min, spot.x_max)


def _composite_image(
    point: GeometricalImage,
    order: Index,
    window: Window,
    unscattered: Real,
    doubt: float,
    halo: Halo,
    detector: Detector,
    tolerance: Tolerance,
) -> CompositeImage:
    """The image of one point, whose light in the ``window`` without scatter is known but for a ``doubt``."""
    edges_x, edges_y = detector.edges(0), detector.edges(1)
    (rows, columns), weight = window, halo.unscattered_weight
    light = np.zeros((detector.sub_pixels, detector.sub_pixels))
    error = unresolved = 0.0
    if halo.mixture.weight.size:
        _add_by_moments(light, edges_x, edges_y, halo.mixture, point, order, tolerance)
    if np.any(order < 0):
        narrow = add_narrow(light, point, halo, order < 0, unscattered, window, detector, tolerance)
        weight, error, unresolved = weight + narrow.joined, narrow.error, narrow.unresolved
    light[rows, columns] += weight * unscattered
    beside = rays_around(point, detector.bounds(), detector.pixel)
    around = np.stack([beside.y - edges_y[0], beside.x - edges_x[0]]) / detector.sub_pixel
    return CompositeImage(
        light, unscattered, rows, columns, weight * doubt + error, unresolved, around, float(beside.share.sum())
    )


def _add_by_moments(
    image: Real,
    edges_x: Real,
    edges_y: Real,
    mixture: GaussianMixture,
    point: GeometricalImage,
    order: Index,
    tolerance: Tolerance,
) -> None:
    """Add the terms whose ``order`` is not negative, in nested blocks about the centroid, the widest first."""
    radius = _radius_of_influence(mixture, point.spot, tolerance)
    whole = 0.5 * math.hypot(edges_x[-1] - edges_x[0], edges_y[-1] - edges_y[0])
    level = np.maximum(np.floor(np.log(whole / radius) / math.log(_LEVEL)), 0.0)
    level[radius < _SMALLEST_BLOCK * (edges_x[1] - edges_x[0])] = np.inf
    centre_x, centre_y = point.spot.centroid_x, point.spot.centroid_y
    for this in np.unique(level[order >= 0]):
        members = (level == this) & (order >= 0)
        reach = float(radius[members].max()) if this > 0.0 else math.inf
        rows = cells_between(edges_y, centre_y - reach, centre_y + reach)
        columns = cells_between(edges_x, centre_x - reach, centre_x + reach)
        left, right = _factors(
            edges_y[rows.start : rows.stop + 1] - centre_y,
            edges_x[columns.start : columns.stop + 1] - centre_x,
            GaussianMixture(mixture.weight[members], mixture.variance[members]),
            point,
            int(order[members].max()),
        )
        if this == 0.0:
            np.matmul(left, right, out=image)
        else:
            image[rows, columns] += left @ right


def _factors(
    edges_y: Real, edges_x: Real, mixture: GaussianMixture, point: GeometricalImage, order: int
) -> tuple[Real, Real]:
    """Matrices (y, column) and (column, x) whose product is the mixture blurred to ``order`` on the cells.

    Columns that symmetry leaves empty are left out.
    """
    moments = moments_to(point, order)
    x = interval_integrals(edges_x[:-1], edges_x[1:], mixture.variance + point.spot.rms_x**2, order)
    y = interval_integrals(edges_y[:-1], edges_y[1:], mixture.variance + point.spot.rms_y**2, order)
    used = np.flatnonzero(np.any(moments != 0.0, axis=1))
    left = np.tensordot(moments[used], y, axes=1) * mixture.weight[:, None]
    return left.reshape(-1, edges_y.size - 1).T, x[used].reshape(-1, edges_x.size - 1)


def _radius_of_influence(mixture: GaussianMixture, spot: Spot, tolerance: Tolerance) -> Real:
    """The distance from the centroid beyond which each term is less than a hundredth of the error allowed [mm]."""
    extent = math.hypot(
        max(spot.x_max - spot.centroid_x, spot.centroid_x - spot.x_min),
        max(spot.y_max - spot.centroid_y, spot.centroid_y - spot.y_min),
    )
    width = np.sqrt(mixture.variance)
    r = np.geomspace(0.1 * width[0], 10.0 * width.max(), 160)
    with np.errstate(under="ignore"):
        light = np.abs(mixture.weight) / mixture.variance * np.exp(-0.5 * np.divide.outer(r, width) ** 2)
        total = light.sum(axis=1)
    farther = np.interp(r + 2.0 * extent, r, total)
    seen = light > 0.01 * tolerance.pixel / mixture.weight.size * farther[:, None]
    last = r.size - 1 - seen[::-1].argmax(axis=0)
    return extent + r[np.minimum(last + 1, r.size - 1)]
