"""The scattered light of Eq. 44: transfer functions, S(r) and its encircled energy.

OTF_S(q) = prod_j H_j(lambda d_j q), H(r) = exp{-max(0, g - K^2 C(r))}; S is the transform of h = OTF_S - exp(-sum g):

    S(r) = 2 pi Int_0^inf q J0(2 pi q r) h(q) dq,     E(R) = 2 pi R Int_0^inf J1(2 pi q R) h(q) dq.

Which to use: ``scatter_psf`` (relative 1e-10 at every radius), ``encircled_fftlog`` and ``scatter_psf_fftlog`` (a
second method, absolute accuracy only, hence the core), ``contour.scatter_psf_mpmath`` and ``panels.scatter_psf_panels``
(single radii at any precision, two methods).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.fft import fht, fhtoffset
from scipy.interpolate import make_interp_spline

from .contour import scatter_table
from .correlation import decorrelation
from .horizon import missing_psf
from .system import RoughSurface, TruthSystem, phase_variance, specular_weight


def surface_exponent(wavelength: float, surface: RoughSurface, q: np.ndarray) -> np.ndarray:
    """K^2 C(lambda d q) - g, unclipped; ``q`` [cycles/mm] of any shape. Positive where q is below the horizon's clip.

    Written as sum K^2 sigma^2 [1 + (B/lambda)^2]^((1-C)/2) - sum K^2 sigma^2 (1 - rho), which keeps its digits at small
    q.
    """
    total = np.zeros_like(np.asarray(q, float))
    for t, beyond in zip(surface.terms, surface.beyond(wavelength), strict=True):
        u = 2.0 * np.pi * wavelength * surface.d * np.asarray(q, float) / t.B
        total += (surface.K * t.sigma) ** 2 * (beyond - decorrelation(u, 0.5 * (t.C - 1.0)))
    return total


def surface_transfer_function(wavelength: float, surface: RoughSurface, q: np.ndarray) -> np.ndarray:
    """H_j(lambda d_j q) = exp{-max(0, g - K^2 C)}, with the clip at the horizon; ``q`` [cycles/mm] of any shape."""
    return np.exp(np.minimum(0.0, surface_exponent(wavelength, surface, q)))


def transfer_function(system: TruthSystem, q: np.ndarray) -> np.ndarray:
    """OTF_S(q), 1 at q = 0 and exp(-sum g) at infinity."""
    factors = [surface_transfer_function(system.wavelength, s, q) for s in system.surfaces]
    return np.prod(factors, axis=0) if factors else np.ones_like(np.asarray(q, float))


def scatter_psf(system: TruthSystem, r: np.ndarray) -> np.ndarray:
    """S(r) [1/mm^2] at radii ``r`` >= 0 [mm] of any shape.

    The table of ``contour`` (degree-7 spline of ln S in ln r) less what the clip takes away (``horizon``). Relative
    error below 1e-10 from r = 0 to 10 d, where S passes through zero beyond about d: there relative to its envelope.
    Farther out the unclipped part continues as its last power law.
    """
    r = np.asarray(r, float)
    if not system.surfaces:
        return np.zeros_like(r)
    return scatter_table(system.wavelength, system.surfaces).psf(r) - missing_psf(system, r)


def _fftlog_grid(system: TruthSystem, points: int) -> tuple[np.ndarray, float]:
    """Log-spaced q [cycles/mm] over 20 decades about B/(lambda d), and the step in ln q."""
    knees = [t.B / (2.0 * np.pi * system.wavelength * s.d) for s in system.surfaces for t in s.terms]
    centre = math.log(math.sqrt(min(knees) * max(knees)))
    s, step = np.linspace(centre - 10.0 * math.log(10.0), centre + 10.0 * math.log(10.0), points, retstep=True)
    return np.exp(s), float(step)


def scatter_psf_fftlog(system: TruthSystem, points: int = 16384) -> tuple[np.ndarray, np.ndarray]:
    """(r, S) on FFTLog's own grid of radii [mm], by scipy.fft.fht with bias 0: S = (1/r) fht(q h).

    Its error is an absolute floor: compared with the contour, relative error below 1e-10 where r < 10 lambda d/B,
    growing as r^2 S falls (1e-7 at 100 lambda d/B for C = 1.8). Use it in the core.
    """
    q, step = _fftlog_grid(system, points)
    h = transfer_function(system, q) - specular_weight(system)
    offset = fhtoffset(step, 0.0, initial=0.0)
    k = math.exp(offset) / q[::-1]
    return k / (2.0 * np.pi), 2.0 * np.pi / k * fht(q * h, step, 0.0, offset=offset)


def encircled_fftlog(system: TruthSystem, radius: np.ndarray, points: int = 16384) -> np.ndarray:
    """E(R), the energy of S within ``radius`` [mm] > 0, by FFTLog of order 1; absolute error below 1e-11.

    h does not vanish at q = 0, which a periodic logarithm punishes: a Gaussian of the same height, whose energy
    1 - exp(-(pi a R)^2) is known, goes first. The answer is interpolated by a quintic spline in ln R.
    """
    q, step = _fftlog_grid(system, points)
    floor = specular_weight(system)
    h = transfer_function(system, q) - floor
    total = -math.expm1(-math.fsum(phase_variance(system.wavelength, s) for s in system.surfaces))
    a = q[np.searchsorted(-h, -0.5 * total)]
    offset = fhtoffset(step, 1.0, initial=0.0)
    k = math.exp(offset) / q[::-1]
    rest = fht(h - total * np.exp(-((q / a) ** 2)), step, 1.0, offset=offset)
    radius = np.asarray(radius, float)
    spline = make_interp_spline(np.log(k / (2.0 * np.pi)), rest, k=5)
    return spline(np.log(radius)) - total * np.expm1(-((np.pi * a * radius) ** 2))
