"""The light that misses a window, by a road of its own: encircled energy by FFTLog and the corner function.

It shares no Gaussian with the pixels, so that sum(PSF) + outside = 1 is a check and not an identity. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import nodes_for_spacing, ray_bundle
from psfcli.image.result import Spot
from psfcli.image.scatter import scatter_terms
from psfcli.surface.harvey_shack import phase_variance, transfer_exponent
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

_POINTS = 4096
_DECADES_BELOW, _DECADES_ABOVE = 7.0, 9.0  # of q about the knees: the transform's period in the logarithm
_CORNER_NODES = 48
_FARTHEST_RAY_SHARE = 0.25  # ray spacing as a share of the distance to the nearest edge


@dataclass(frozen=True, slots=True)
class EncircledEnergy:
    """Scattered light within radius R as a fraction of all light, tabulated at ``exp(log_start + i step)`` [mm]."""

    log_start: float
    step: float
    energy: Real

    def within(self, radius: Real) -> Real:
        """The energy within ``radius`` [mm] by six-point Lagrange interpolation in ln R; shape of ``radius``."""
        with np.errstate(divide="ignore"):
            place = (np.log(radius) - self.log_start) / self.step
        place = np.clip(place, 2.0, self.energy.size - 4.0)
        index = np.minimum(place.astype(np.intp), self.energy.size - 4)
        x = place - index
        total = np.zeros_like(x)
        for i in range(-2, 4):
            basis = np.ones_like(x)
            for j in range(-2, 4):
                if j != i:
                    basis *= (x - j) / (i - j)
            total += basis * self.energy[index + i]
        return total


def encircled_energy(surfaces: Sequence[Surface], telescope: Telescope, wavelength: float) -> EncircledEnergy:
    """E(R) = 2 pi R Int_0^inf [OTF_S(q) - exp(-G)] J1(2 pi q R) dq by FFTLog, with the horizon's clip as it stands.

    Good to about 1e-9 of all light between 1e-5 of the narrowest and 1e4 of the widest core.
    """
    from scipy import fft

    widths = [term.width for term in scatter_terms(surfaces, telescope, wavelength)]
    log_q = np.linspace(
        -math.log(2.0 * math.pi * max(widths)) - _DECADES_BELOW * math.log(10.0),
        -math.log(2.0 * math.pi * min(widths)) + _DECADES_ABOVE * math.log(10.0),
        _POINTS,
    )
    step = float(log_q[1] - log_q[0])
    exponent = np.zeros(_POINTS)
    for surface in surfaces:
        separation = wavelength * telescope.magnified_distance(surface.marginal_height) * np.exp(log_q)
        exponent += np.minimum(0.0, transfer_exponent(separation, surface, wavelength))
    total_variance = sum(phase_variance(surface, wavelength) for surface in surfaces)
    h = math.exp(-total_variance) * np.expm1(np.maximum(exponent + total_variance, 0.0))
    offset = fft.fhtoffset(step, mu=1.0, bias=-0.5)
    energy = fft.fht(h, step, mu=1.0, offset=offset, bias=-0.5)
    # fht's output is at k = exp(offset)/q, reversed, and k = 2 pi R
    return EncircledEnergy(float(offset - log_q[-1] - math.log(2.0 * math.pi)), step, energy)


def scattered_outside(
    telescope: Telescope,
    field: Field,
    spot: Spot,
    encircled: EncircledEnergy | None,
    scattered_fraction: float,
    core_width: float,
    window: tuple[float, float, float, float],
) -> float:
    """The scattered light, as a fraction of all light, outside the ``window`` (x_start, x_stop, y_start, y_stop) [mm].

    A rectangle is a signed sum of four corners, each I(X, Y) = (1/2 pi)[Int_0^atan(Y/X) E(X/cos t) dt + the like in
    Y], averaged over rays through the pupil.
    """
    if encircled is None:
        return 0.0
    x_start, x_stop, y_start, y_stop = window
    clearance = min(
        abs(edge - bound)
        for edges, bounds in (((x_start, x_stop), (spot.x_min, spot.x_max)), ((y_start, y_stop), (spot.y_min, spot.y_max)))
        for edge in edges
        for bound in bounds
    )
    spacing = max(core_width, _FARTHEST_RAY_SHARE * clearance)
    rays = ray_bundle(telescope, field, *nodes_for_spacing(telescope, field, spacing))
    inside = 0.0
    for first in range(0, rays.x.size, 512):
        part = slice(first, first + 512)
        x, y, share = rays.x[part], rays.y[part], rays.share[part]
        corners = (
            _corner(encircled, x_stop - x, y_stop - y)
            - _corner(encircled, x_start - x, y_stop - y)
            - _corner(encircled, x_stop - x, y_start - y)
            + _corner(encircled, x_start - x, y_start - y)
        )
        inside += float(share @ corners)
    return scattered_fraction - inside


def _corner(encircled: EncircledEnergy, x: Real, y: Real) -> Real:
    """I(X, Y), the energy in the rectangle from the origin to (X, Y), odd in both; shape of ``x``."""
    node, weight = np.polynomial.legendre.leggauss(_CORNER_NODES)
    X, Y = np.abs(x), np.abs(y)
    total = np.zeros_like(x)
    for near, far in ((X, Y), (Y, X)):
        # t = asinh-like substitution R = near cosh(s): dt = ds/cosh(s) stays smooth however long the rectangle
        with np.errstate(divide="ignore", invalid="ignore"):
            longest = np.arcsinh(np.where(near > 0.0, far / near, 0.0))
        s = 0.5 * longest[:, None] * (node + 1.0)
        energy = encircled.within(near[:, None] * np.cosh(s)) / np.cosh(s)
        total += 0.5 * longest * (energy @ weight)
    return np.sign(x) * np.sign(y) * total / (2.0 * math.pi)
