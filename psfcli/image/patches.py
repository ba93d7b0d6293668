"""Rays through the pupil, as close together where they land as asked, patch by patch [mm].

The pupil is cut into rings of equal path along the radius, Gauss's rule in each; a ring takes as many azimuths as its
own fastest path along the azimuth asks for. A Gaussian of width s summed over rays a spacing apart errs by
2 exp(-2 pi^2 s^2/spacing^2), the error of the trapezoid rule, to which Gauss's rule comes with ``_GAUSS`` times its
nodes. Neighbours in the pupil are neighbours in the image: patches that land far from a window are never made.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import (
    LARGEST_PANEL,
    GeometricalImage,
    RayBundle,
    along_fans,
    pupil_azimuths,
    ray_fans,
)
from psfcli.image.quadrature import gauss_legendre
from psfcli.image.result import Spot
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Window = tuple[float, float, float, float]  # x_start, x_stop, y_start, y_stop [mm]

MOST_RAYS = 6_000_000
EVERYWHERE: Window = (-math.inf, math.inf, -math.inf, math.inf)
_GAUSS = 1.67  # on panels of LARGEST_PANEL nodes; measured for errors from 1e-3 to 1e-10
_SIDE = 8  # rays of a patch along the radius, at most, and along the azimuth
_FEWEST_RADII, _FEWEST_AZIMUTHS = 6.0, 6.0  # a ray error is a cubic in the radius, two harmonics in azimuth
_SLOWEST = 0.02  # of the largest speed: no ring is wider in the pupil than this lets it be
_PATCHES_AT_ONCE, _RAYS_AT_ONCE = 16, 1024  # that a processor's cache holds
_RINGS, _SPOKES = 48, 96  # of the table of speeds


@dataclass(frozen=True, slots=True)
class RayCount:
    """How many rays land a spacing h [mm] apart: the polynomial ``coefficients`` (3,) in 1/h."""

    coefficients: tuple[float, float, float]

    def at(self, spacing: Real) -> Real:
        """Rays that are ``spacing`` [mm] apart; shape of ``spacing``."""
        constant, linear, square = self.coefficients
        return constant + (linear + square / spacing) / spacing

    def closest(self) -> float:
        """The spacing [mm] at which there are MOST_RAYS, 0 for a point."""
        constant, linear, square = self.coefficients
        more = MOST_RAYS - constant
        return 0.5 * (linear + math.sqrt(linear**2 + 4.0 * square * more)) / more


def ray_count(image: GeometricalImage, window: Window = EVERYWHERE) -> RayCount:
    """The rays of ``patches_apart`` that land in the ``window``."""
    rings = _rings(image.telescope, image.field)
    inside = rings.inside(window)
    start, stop = image.telescope.pupil.sector
    radii = _FEWEST_RADII / _RINGS, _GAUSS * rings.radial
    azimuths = _FEWEST_AZIMUTHS, _azimuthal_nodes(image) * (stop - start) * rings.azimuthal
    return RayCount(
        (
            float(np.sum(inside * radii[0] * azimuths[0])),
            float(np.sum(inside * (radii[0] * azimuths[1] + radii[1] * azimuths[0]))),
            float(np.sum(inside * radii[1] * azimuths[1])),
        )
    )


def rays_around(image: GeometricalImage, window: Window, margin: float) -> RayBundle:
    """Rays of a coarse table that land outside the ``window``, within ``margin`` [mm] of it and their own distance.

    Shares are of all light; together no less than what lands within the ``margin``. None where the window holds all.
    """
    if _holds(window, image.spot):
        return RayBundle(*np.empty((3, 0)))
    rings = _rings(image.telescope, image.field)
    start, stop = image.telescope.pupil.sector
    margin += max(float(rings.radial.max()), float(rings.azimuthal.max()) * (stop - start) / _SPOKES)
    x_start, x_stop, y_start, y_stop = window
    wide = x_start - margin, x_stop + margin, y_start - margin, y_stop + margin
    beside = _within(wide, rings.x, rings.y) & ~_within(window, rings.x, rings.y)
    return RayBundle(rings.share()[beside], rings.x[beside], rings.y[beside])


def patches_apart(
    image: GeometricalImage, spacing: float, *, half: bool = False, window: Window = EVERYWHERE
) -> Iterator[RayBundle]:
    """Rays at the nodes of a pupil quadrature, ``spacing`` [mm] apart at most, in bundles of shape (patch, ray).

    Shares add to 1 but for patches far outside the ``window``. ``half``, for mirror-symmetric images: those on one
    side of the field direction, standing for both.
    """
    if image.telescope.seidel == SeidelTable():
        yield RayBundle(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
        return
    if _holds(window, image.spot):
        window = EVERYWHERE
    for edges, radii, azimuths in _panels(image, spacing):
        each = radii if radii <= _SIDE else LARGEST_PANEL
        yield from _ring(image, edges, each, azimuths, spacing, half=half, window=window)


def rays_apart(image: GeometricalImage, spacing: float, fewest: int, *, half: bool = False) -> Iterator[RayBundle]:
    """The rays of ``patches_apart`` wherever they land, no more than asked for, in bundles of shape (ray,).

    ``fewest`` radii and azimuths there are in any case: of spots far smaller than the ``spacing`` moments are asked.
    """
    if image.telescope.seidel == SeidelTable():
        yield RayBundle(np.ones(1), np.zeros(1), np.zeros(1))
        return
    for edges, asked_radii, azimuths in _panels(image, spacing):
        radii = max(asked_radii, fewest)
        rho, lit = _lit_radii(image, edges, radii)
        count = 2 * math.ceil(0.5 * max(azimuths, fewest))
        azimuth, slice_weight = pupil_azimuths(image.telescope, image.field, count, half=half)
        together = max(1, _RAYS_AT_ONCE // radii)
        for first in range(0, azimuth.size, together):
            some = slice(first, first + together)
            x, y = (along_fans(fans, rho).ravel() for fans in ray_fans(image.telescope, image.field, azimuth[some]))
            yield RayBundle(np.outer(lit, slice_weight[some]).ravel(), x, y)


def _panels(image: GeometricalImage, spacing: float) -> Iterator[tuple[tuple[float, float], int, int]]:
    """Rings of equal path along the radius, of LARGEST_PANEL radii at most: edges, radii and azimuths of each."""
    rings = _rings(image.telescope, image.field)
    path = np.append(0.0, np.cumsum(np.maximum(rings.radial, _SLOWEST * rings.radial.max())))
    start, stop = image.telescope.pupil.sector
    radii = _FEWEST_RADII + _GAUSS * path[-1] / spacing
    count = math.ceil(radii / LARGEST_PANEL)
    edges = np.interp(np.linspace(0.0, path[-1], count + 1), path, rings.rho) if count > 1 else rings.rho[[0, -1]]
    per_azimuth = _azimuthal_nodes(image) * (stop - start) / spacing
    for inner, outer in itertools.pairwise(edges.tolist()):
        met = (rings.rho[1:] > inner) & (rings.rho[:-1] < outer)
        azimuths = _FEWEST_AZIMUTHS + per_azimuth * float(rings.azimuthal[met].max())
        yield (inner, outer), math.ceil(radii / count), math.ceil(azimuths)


def _lit_radii(image: GeometricalImage, edges: tuple[float, float], count: int) -> tuple[Real, Real]:
    """``count`` pupil radii between two ``edges`` by Gauss's rule, and the light that each stands for."""
    inner, outer = edges
    node, weight = gauss_legendre(count)
    rho = 0.5 * (inner + outer) + 0.5 * (outer - inner) * node
    return rho, rho * weight * ((outer - inner) / (1.0 - image.telescope.pupil.obscuration**2))


@dataclass(frozen=True, slots=True)
class _Rings:
    """A table of rings between the pupil radii ``rho`` (n + 1,): how far a ray lands from the next, in the worst place.

    ``radial`` [mm] across the ring, ``azimuthal`` [mm/rad] along it, (n,); ``x`` and ``y`` (n + 1, ray) [mm], where
    rays of each radius land.
    """

    rho: Real
    radial: Real
    azimuthal: Real
    x: Real
    y: Real

    def inside(self, window: Window) -> Real:
        """The part of each ring that lands in the ``window``; (n,)."""
        return _within(window, self.x[1:], self.y[1:]).mean(axis=1)

    def share(self) -> Real:
        """The light that each ray stands for, shape (n + 1, ray): by the trapezoid rule it adds to 1."""
        lit = self.rho * np.append(0.5, np.append(np.ones(self.rho.size - 2), 0.5))
        return np.broadcast_to((lit / lit.sum())[:, None] / self.x.shape[1], self.x.shape)


@lru_cache(maxsize=16)  # every Gaussian of a field asks for them, and a few fields are computed together
def _rings(telescope: Telescope, field: Field) -> _Rings:
    """The rings of one point of the field."""
    start, stop = telescope.pupil.sector
    azimuth = np.linspace(start, stop, _SPOKES + 1)
    rho = np.linspace(telescope.pupil.obscuration, 1.0, _RINGS + 1)
    x, y = (along_fans(fans, rho) for fans in ray_fans(telescope, field, azimuth))
    along = np.sqrt(np.diff(x, axis=0) ** 2 + np.diff(y, axis=0) ** 2)  # hypot takes five times as long
    around = np.sqrt(np.diff(x, axis=1) ** 2 + np.diff(y, axis=1) ** 2).max(axis=1) * _SPOKES / (stop - start)
    return _Rings(rho, along.max(axis=1), np.maximum(around[1:], around[:-1]), x, y)


def _holds(window: Window, spot: Spot) -> bool:
    """Whether no ray lands outside the ``window``."""
    x_start, x_stop, y_start, y_stop = window
    return x_start <= spot.x_min and spot.x_max <= x_stop and y_start <= spot.y_min and spot.y_max <= y_stop


def _within(window: Window, x: Real, y: Real) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (x >= window[0]) & (x <= window[1]) & (y >= window[2]) & (y <= window[3])
    return inside


def _azimuthal_nodes(image: GeometricalImage) -> float:
    """Azimuths for one of the trapezoid rule."""
    return 1.0 if image.telescope.pupil.is_full_annulus else _GAUSS


def _ring(
    image: GeometricalImage,
    edges: tuple[float, float],
    radii: int,
    azimuths: int,
    spacing: float,
    *,
    half: bool,
    window: Window,
) -> Iterator[RayBundle]:
    """The rays of one ring between the pupil radii ``edges``."""
    rho, lit = _lit_radii(image, edges, radii)
    azimuths = LARGEST_PANEL * math.ceil(azimuths / LARGEST_PANEL)
    azimuth, slice_weight = pupil_azimuths(image.telescope, image.field, azimuths, half=half)
    side = min(radii, _SIDE)
    rho, lit, slice_weight = rho.reshape(-1, side), lit.reshape(-1, side), slice_weight.reshape(-1, _SIDE)
    fans = np.stack(ray_fans(image.telescope, image.field, azimuth)).reshape(2, 4, -1, _SIDE)
    row, column = np.indices((len(rho), len(slice_weight))).reshape(2, -1)
    seen = np.arange(row.size)
    if window != EVERYWHERE:
        few_radii, few_fans = rho[:, [0, side // 2, -1]], fans[..., [0, _SIDE // 2, -1]]
        seen = np.flatnonzero(_near_window(*_landing(few_fans[:, :, column], few_radii[row]), spacing, window))
    for first in range(0, seen.size, _PATCHES_AT_ONCE):
        some = seen[first : first + _PATCHES_AT_ONCE]
        rows, columns = row[some], column[some]
        share = lit[rows, :, None] * slice_weight[columns, None, :]
        yield RayBundle(share.reshape(some.size, -1), *_landing(fans[:, :, columns], rho[rows]))


def _landing(fans: Real, rho: Real) -> tuple[Real, Real]:
    """X and y of the rays of patches (patch, ray) along their ``fans`` (2, 4, patch, azimuth) at radii ``rho``."""
    x, y = (along_fans(of, rho).reshape(len(rho), -1) for of in fans)
    return x, y


def _near_window(x: Real, y: Real, spacing: float, window: Window) -> NDArray[np.bool_]:
    """Whether patches, known by a few of their rays, may reach into the window; shape (patch,)."""
    slack = spacing + 0.5 * np.maximum(np.ptp(x, axis=1), np.ptp(y, axis=1))
    return (
        (x.max(axis=1) + slack >= window[0])
        & (x.min(axis=1) - slack <= window[1])
        & (y.max(axis=1) + slack >= window[2])
        & (y.min(axis=1) - slack <= window[3])
    )
