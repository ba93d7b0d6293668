"""Gaussians too narrow for the spot's moments, on the detector's grid: from rays, or as none at all [mm]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import (
    FEW_TERMS,
    FEWER_TERMS,
    TAIL,
    fewer_terms,
    normal_probability,
    ray_error,
    ray_spacing,
    shares,
)
from psfcli.image.blurred import terms_for
from psfcli.image.geometric import GeometricalImage
from psfcli.image.grid import Detector
from psfcli.image.patches import ray_count, rays_around
from psfcli.image.scatter import Halo
from psfcli.image.spot_grid import SpotGrid, spot_grids
from psfcli.image.unscattered import Window
from psfcli.surface.mixture import GaussianMixture
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_LOCAL = 0.125  # of a sub-pixel: Gaussians narrower than this do not reach the one after next
_SHARE = 0.1  # of the tolerance, for each term in dark pixels, and for all together in lit ones
_RADII_PER_DECADE = 30  # where a term's share of the light is looked at, out to ten times the widest


@dataclass(frozen=True, slots=True)
class Narrow:
    """What becomes of the narrow terms of a mixture.

    ``joined``: the weight of those that cannot be told from none, to be added to that of the unscattered light. The
    others err by ``error`` of all light in lit sub-pixels, at most, and by ``unresolved``, relative and beyond their
    share of the tolerance, elsewhere.
    """

    joined: float
    error: float
    unresolved: float


def add_narrow(
    light: Real,
    point: GeometricalImage,
    halo: Halo,
    narrow: NDArray[np.bool_],
    unscattered: Real,
    window: Window,
    detector: Detector,
    tolerance: Tolerance,
) -> Narrow:
    """Add the ``narrow`` terms of the ``halo`` to the ``light``; PSF_G is ``unscattered`` in the cells of ``window``.

    The spacing of the rays, or the share of rays that are taken, tells the error: in lit sub-pixels the aliases of the
    rays are of all light about a pixel, but those of Gaussians far narrower than a sub-pixel act at its edges alone.
    An edge errs by ``ray_error``/2 pi of the light within a spacing of it, by Poisson's sum, and a pixel has four.
    """
    edges_x, edges_y = detector.edges(0), detector.edges(1)
    mixture = halo.mixture
    brightest = 9.0 * float(unscattered.max(initial=0.0)) * max(1, 4 * (detector.oversample - 1))
    around = float(rays_around(point, detector.bounds(), detector.sub_pixel).share.sum())
    brightest = min(max(brightest, around, _on_border(unscattered, *window, detector.sub_pixels)), 1.0)
    free = nearest_dark(point, detector) if halo.unscattered_weight > 0.0 else 0.0
    allowed = narrow_error(mixture, tolerance, free, brightest)
    strict = narrow & (allowed < 1.0)
    # what is much narrower than a sub-pixel blurs its edges alone
    local = strict & (mixture.variance < (_LOCAL * free) ** 2)
    others = strict & ~local
    bounds = detector.bounds()
    closest = ray_count(point, bounds).closest()
    rest = mixture.only(others)
    edges = mixture.only(local)
    for count, power in ((terms_for(np.array([tolerance.ee]), edges), 0.25), (FEW_TERMS, 1.0), (FEWER_TERMS, 1.0)):
        few = fewer_terms(edges, count, power)
        blurring = GaussianMixture(np.append(few.weight, rest.weight), np.append(few.variance, rest.variance))
        errors = np.append(narrow_error(few, tolerance, math.inf, brightest), allowed[others])
        spacing = ray_spacing(np.sqrt(blurring.variance), errors)
        if np.all(spacing >= closest):
            break
    spacing = np.maximum(spacing, closest)
    error = 0.0
    for grid in spot_grids(point, blurring, spacing, bounds):
        _add_by_grid(light, edges_x, edges_y, grid)
        # of a spot beside the window nothing local reaches it
        on_edge = 0.0 if _gap(point, detector) > 0.0 else grid.on_a_line(grid.spacing)
        near = np.where(grid.mixture.variance < (_LOCAL * free) ** 2, on_edge, brightest)
        aliases = ray_error(np.sqrt(grid.mixture.variance), np.array(grid.spacing))
        error += float(np.abs(grid.mixture.weight) @ (near * aliases))
    part = _largest_parts(mixture, free)[others]
    aliases = ray_error(np.sqrt(rest.variance), spacing[few.weight.size :])
    return Narrow(
        joined=float(mixture.weight[narrow & ~strict].sum()),
        error=error,
        unresolved=float(np.max(part * aliases - _SHARE * tolerance.pixel, initial=0.0)),
    )


def nearest_dark(point: GeometricalImage, detector: Detector) -> float:
    """How near [mm] rays come to sub-pixels that neither they nor their neighbours touch: one sub-pixel, or less where

    all rays miss the window, and nothing in it is touched.
    """
    gap = _gap(point, detector)
    return min(detector.sub_pixel, gap) if gap > 0.0 else detector.sub_pixel


def _gap(point: GeometricalImage, detector: Detector) -> float:
    """How far [mm] the bounds of the spot are from the window, along x or y; not positive where they meet."""
    x_start, x_stop, y_start, y_stop = detector.bounds()
    spot = point.spot
    return max(x_start - spot.x_max, spot.x_min - x_stop, y_start - spot.y_max, spot.y_min - y_stop)


def narrow_error(mixture: GaussianMixture, tolerance: Tolerance, nearest: float, brightest: float) -> Real:
    """The relative error that each term of a ``mixture`` may have in pixels, shape (term,).

    Where unscattered light touches, and of all light no more than ``brightest`` falls on a pixel with its neighbours,
    the allowance is absolute; rays are ``nearest`` [mm] or farther from all other pixels, where it is relative to all
    the light that the mixture sends there.
    """
    if mixture.weight.size == 0:
        return np.zeros(0)
    with np.errstate(divide="ignore", over="ignore"):  # what is allowed any error at all
        inside = _SHARE * tolerance.ee / (mixture.weight.size * np.abs(mixture.weight) * max(brightest, 1e-300))
        allowed: Real = np.minimum(inside, _SHARE * tolerance.pixel / _largest_parts(mixture, nearest))
    return allowed


def _largest_parts(mixture: GaussianMixture, nearest: float) -> Real:
    """Each term's largest part of the mixture's light at distances ``nearest`` [mm] or farther, shape (term,)."""
    width = np.sqrt(mixture.variance)
    decades = np.arange(-1.0, 1.0 + math.log10(width.max() / width.min()), 1.0 / _RADII_PER_DECADE)
    part: Real = shares(mixture, np.append(nearest, nearest + width.min() * 10.0**decades)).max(axis=0)
    return part


def cells_between(edges: Real, low: float, high: float) -> slice:
    """The cells that the interval from ``low`` to ``high`` touches, and one more on either side."""
    first = int(np.searchsorted(edges, low, side="right")) - 2
    last = int(np.searchsorted(edges, high, side="left")) + 1
    cells = edges.size - 1
    return slice(min(max(first, 0), cells), max(min(last, cells), 0))


def _on_border(unscattered: Real, rows: slice, columns: slice, sub_pixels: int) -> float:
    """What of PSF_G lies within two sub-pixels of the window's edge, on either side: what blur may take across it."""
    border = np.ones(unscattered.shape, dtype=bool)
    inner = (
        slice(max(2 - rows.start, 0), max(sub_pixels - 2 - rows.start, 0)),
        slice(max(2 - columns.start, 0), max(sub_pixels - 2 - columns.start, 0)),
    )
    border[inner] = False
    return 2.0 * float(unscattered.sum(where=border))


def _add_by_grid(image: Real, edges_x: Real, edges_y: Real, grid: SpotGrid) -> None:
    for weight, variance in zip(grid.mixture.weight, grid.mixture.variance, strict=True):
        margin, width = TAIL * math.sqrt(variance), math.sqrt(variance - grid.tau2)
        rows = cells_between(edges_y, grid.y[0] - margin, grid.y[-1] + margin)
        columns = cells_between(edges_x, grid.x[0] - margin, grid.x[-1] + margin)
        if rows.stop <= rows.start or columns.stop <= columns.start:
            continue
        y = (edges_y[rows.start : rows.stop + 1, None] - grid.y) / width
        x = (edges_x[columns.start : columns.stop + 1, None] - grid.x) / width
        left = weight * normal_probability(y[:-1], y[1:]) @ grid.mass
        image[rows, columns] += left @ normal_probability(x[:-1], x[1:]).T
