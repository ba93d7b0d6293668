"""The light that misses a window, by a road of its own: encircled energy by FFTLog and the corner function.

It shares no Gaussian with the pixels, so that sum(PSF) + outside = 1 is a check and not an identity. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import ray_spacing
from psfcli.image.geometric import GeometricalImage
from psfcli.image.graded import graded_rays
from psfcli.image.grid import Detector
from psfcli.image.quadrature import gauss_legendre
from psfcli.image.scatter import Halo, scatter_terms
from psfcli.image.unscattered import unscattered_on_grid
from psfcli.surface.harvey_shack import phase_variance, transfer_exponent
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_POINTS = 1024, 4096  # of the table: good to 1e-7 and 1e-9 of all light
_COARSE_ENOUGH = 1e-6  # energies asked no finer than this take the smaller table
_DECADES_BELOW, _DECADES_ABOVE = 7.0, 9.0  # of q about the knees: the transform's period in the logarithm
_DECADES_BEYOND = 3.0  # of q below the farthest distance
_CORNER_NODES, _FEW_NODES = 48, 16  # for corners however far along an edge, and within _SHORT
_SHORT = 3.0  # of asinh(far/near)
_RAYS_AT_ONCE = 512
_FEWEST_RAYS = 4  # of a cell, either way
_MORE_RAYS = 1  # than digits asked for: where the spot is a few cells, measured, they leave a tenth of the tolerance
_CELL_SHARE = 0.9  # of the distance to the nearest edge: how wide a cell of rays may be
_SHARE = 0.3  # of the tolerance, for the narrow cores between the rays


@dataclass(frozen=True, slots=True)
class EncircledEnergy:
    """Scattered light within radius R as a fraction of all light: a polynomial per step of ln R.

    ``coefficients`` (6, steps), of falling power of (ln R - log_start)/step - i on step i.
    """

    log_start: float
    step: float
    coefficients: Real

    @classmethod
    def through(cls, log_start: float, step: float, energy: Real) -> EncircledEnergy:
        """Six-point Lagrange interpolation of ``energy`` at ``exp(log_start + i step)`` [mm], for 2 <= i < n - 3."""
        nodes = np.arange(-2.0, 4.0)
        to_polynomial = np.linalg.inv(np.vander(nodes))
        neighbours = np.lib.stride_tricks.sliding_window_view(energy, nodes.size)
        return cls(log_start + 2.0 * step, step, to_polynomial @ neighbours.T)

    def within(self, radius: Real) -> Real:
        """The energy within ``radius`` [mm]; shape of ``radius``. Beyond the table, that at its end."""
        with np.errstate(divide="ignore"):
            place = (np.log(radius) - self.log_start) / self.step
        place = np.clip(place, 0.0, self.coefficients.shape[1] - 1.0)
        index = place.astype(np.intp)
        x = place - index
        total = self.coefficients[0][index]
        for coefficient in self.coefficients[1:]:
            total = total * x + coefficient[index]
        return total


def encircled_energy(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, reach: float, tolerance: Tolerance
) -> EncircledEnergy:
    """E(R) = 2 pi R Int_0^inf [OTF_S(q) - exp(-G)] J1(2 pi q R) dq by FFTLog, with the horizon's clip as it stands.

    Good to about 1e-7 of all light, or 1e-9 when ``tolerance.ee`` is below 1e-6, between 1e-5 of the narrowest and 1e4
    of the widest core, and out to ``reach`` [mm].
    """
    from scipy import fft

    widths = [term.width for term in scatter_terms(surfaces, telescope, wavelength)]
    below = max(_DECADES_BELOW, _DECADES_BEYOND + math.log10(reach / max(widths)))
    points = int(_POINTS[tolerance.ee < _COARSE_ENOUGH] * max(1.0, below / _DECADES_BELOW))
    log_q = np.linspace(
        -math.log(2.0 * math.pi * max(widths)) - below * math.log(10.0),
        -math.log(2.0 * math.pi * min(widths)) + _DECADES_ABOVE * math.log(10.0),
        points,
    )
    step = float(log_q[1] - log_q[0])
    exponent = np.zeros(points)
    for surface in surfaces:
        separation = wavelength * telescope.magnified_distance(surface.marginal_height) * np.exp(log_q)
        exponent += np.minimum(0.0, transfer_exponent(separation, surface, wavelength))
    total_variance = sum(phase_variance(surface, wavelength) for surface in surfaces)
    if total_variance < 1.0:
        h = math.exp(-total_variance) * np.expm1(
            np.maximum(exponent + total_variance, 0.0)
        )  # to full relative accuracy however smooth the surfaces
    else:
        h = np.exp(exponent) - math.exp(-total_variance)
    offset = fft.fhtoffset(step, mu=1.0, bias=-0.5)
    energy = fft.fht(h, step, mu=1.0, offset=offset, bias=-0.5)
    # fht's output is at k = exp(offset)/q, reversed, and k = 2 pi R
    return EncircledEnergy.through(float(offset - log_q[-1] - math.log(2.0 * math.pi)), step, energy)


def outside_window(
    point: GeometricalImage,
    halo: Halo,
    encircled: EncircledEnergy | None,
    detector: Detector,
    tolerance: Tolerance,
) -> float:
    """The fraction of all light that misses the detector's window, within ``tolerance.ee``."""
    x_start, x_stop, y_start, y_stop = window = detector.bounds()
    spot = point.spot
    outside = 0.0
    if halo.specular_fraction > 0.0 and not (
        x_start < spot.x_min and spot.x_max < x_stop and y_start < spot.y_min and spot.y_max < y_stop
    ):
        edges_x, edges_y = np.array([x_start, x_stop]), np.array([y_start, y_stop])
        cell, _ = unscattered_on_grid(point, edges_x, edges_y, 0.3 * tolerance.ee / halo.specular_fraction)
        outside += halo.specular_fraction * (1.0 - float(cell[0, 0]))
    if encircled is not None:
        rays = max(_FEWEST_RAYS, math.ceil(-math.log10(tolerance.ee)) + _MORE_RAYS)
        inside = _scattered_inside(point, encircled, _closest(halo, tolerance), rays, window)
        outside += (1.0 - halo.specular_fraction) - inside
    return outside


def _closest(halo: Halo, tolerance: Tolerance) -> float:
    """The ray spacing [mm] at which all cores up to any width err by no more than a share of ``tolerance.ee``.

    Each as if it were as wide as the narrowest that rays so far apart resolve: the fewer hold the less light, the
    farther apart.
    """
    width = np.sqrt(halo.mixture.variance)
    held = np.cumsum(np.abs(halo.mixture.weight))
    return float(ray_spacing(width, _SHARE * tolerance.ee / held).min())


def _scattered_inside(
    point: GeometricalImage,
    encircled: EncircledEnergy,
    closest: float,
    nodes: int,
    window: tuple[float, float, float, float],
) -> float:
    """The scattered light, as a fraction of all light, inside the ``window`` (x_start, x_stop, y_start, y_stop) [mm].

    A rectangle is a signed sum of four corners, each I(X, Y) = (1/2 pi)[Int_0^atan(Y/X) E(X/cos t) dt + the like in
    Y], averaged over rays through the pupil: ``closest`` [mm] together where an edge is near the spot, and ``nodes`` by
    ``nodes`` in a cell.
    """
    x_start, x_stop, y_start, y_stop = window
    half_x, half_y = 0.5 * (x_stop - x_start), 0.5 * (y_stop - y_start)

    def spacing(x: Real, y: Real) -> Real:
        """The closest at the window's edge; far from it, a share of the distance."""
        from_edge = np.abs(np.maximum(np.abs(x - x_start - half_x) - half_x, np.abs(y - y_start - half_y) - half_y))
        return np.maximum(closest, _CELL_SHARE / (nodes - 1) * from_edge)

    rays = graded_rays(point, spacing, nodes)
    inside = 0.0
    for first in range(0, rays.x.size, _RAYS_AT_ONCE):
        part = slice(first, first + _RAYS_AT_ONCE)
        x, y, share = rays.x[part], rays.y[part], rays.share[part]
        to_x, to_y = np.stack([x_stop - x, x_start - x]), np.stack([y_stop - y, y_start - y])
        corners = _corner(encircled, np.tile(to_x, (2, 1)), np.repeat(to_y, 2, axis=0))
        inside += float(np.array([1.0, -1.0, -1.0, 1.0]) @ corners @ share)
    return inside


def _corner(encircled: EncircledEnergy, x: Real, y: Real) -> Real:
    """I(X, Y), the energy in the rectangle from the origin to (X, Y), odd in both; shape of ``x``."""
    X, Y = np.abs(x), np.abs(y)
    near, far = np.stack([X, Y]), np.stack([Y, X])
    # t = asinh-like substitution R = near cosh(s): dt = ds/cosh(s) stays smooth however long the rectangle
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.arcsinh(np.where(near > 0.0, far / near, 0.0))
    total = np.empty_like(near)
    for some, count in ((longest < _SHORT, _FEW_NODES), (longest >= _SHORT, _CORNER_NODES)):
        node, weight = gauss_legendre(count)
        cosh = np.cosh(0.5 * longest[some, None] * (node + 1.0))
        total[some] = 0.5 * longest[some] * ((encircled.within(near[some, None] * cosh) / cosh) @ weight)
    return np.sign(x) * np.sign(y) * total.sum(axis=0) / (2.0 * math.pi)
