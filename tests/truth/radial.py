"""S(r) and its encircled energy, tabled once per system in doubles: milliseconds where ``contour`` takes seconds.

S comes from ``contours``, without the clip at the horizon, which is then subtracted (``horizon``), or with it,
whichever loses fewer digits. Energies are shells added up, from the centre and from the outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, make_interp_spline

from .contours import STEP, STRIDE, clipped, unclipped
from .horizon import missing_psf
from .system import RoughSurface, TruthSystem, phase_variance

_CUBIC_STEP = 2e-3  # as exact as the splines: 1e-13
_TINY = 1e-300
NOISE = 1e-9  # the largest relative noise handed out


class CubicTable:
    """A smooth function of ln r as cubics on even steps, read off a spline; constant beyond its ends."""

    def __init__(self, spline: BSpline, low: float, high: float) -> None:
        count = math.ceil((high - low) / _CUBIC_STEP)
        grid = low + _CUBIC_STEP * np.arange(count + 1)
        self._low, self._most = low, count - 1e-9
        self._coefficients = CubicHermiteSpline(grid, spline(grid), spline(grid, 1)).c * (
            _CUBIC_STEP ** np.arange(3, -1, -1)[:, None]
        )

    def __call__(self, log_r: np.ndarray) -> np.ndarray:
        place = np.clip((log_r - self._low) / _CUBIC_STEP, 0.0, self._most)
        index = place.astype(np.intp)
        place -= index
        cubic, square, linear, constant = (c.take(index) for c in self._coefficients)
        return ((cubic * place + square) * place + linear) * place + constant


@dataclass(frozen=True)
class RadialScatter:
    """Tables in ln r: ``log_density`` of ln S but for the factor ``clip``; of ln of the energies within and beyond r.

    ``worst`` is the largest relative noise, ``closure`` what the shells and the tail miss of 1 - exp(-sum g).
    """

    first: float
    log_density: CubicTable
    clip: CubicTable
    log_inside: CubicTable
    log_outside: CubicTable
    worst: float
    closure: float

    def psf(self, square: np.ndarray) -> np.ndarray:
        """S [1/mm^2] at radii of given ``square`` [mm^2]; constant within ``first``, where it falls by 1e-8 of itself.

        Relative error: the larger of ``worst`` and 1e-10.
        """
        log_r = 0.5 * np.log(square + _TINY)
        return np.exp(self.log_density(log_r)) * self.clip(log_r)

    def inside(self, square: np.ndarray) -> np.ndarray:
        """Energy within a radius of given ``square`` [mm^2]; relative accuracy."""
        energy = np.exp(self.log_inside(0.5 * np.log(square + _TINY)))
        return energy * np.minimum(square / self.first**2, 1.0)

    def outside(self, square: np.ndarray) -> np.ndarray:
        """Energy beyond, but for a constant: good for differences, relative to the outer value."""
        return np.exp(self.log_outside(0.5 * np.log(square + _TINY)))


def radial_scatter(system: TruthSystem, reach: float) -> RadialScatter:
    """S of the system's surfaces from the centre to ``reach`` [mm].

    Raises ArithmeticError where no contour leaves a relative noise below ``NOISE``.
    """
    return _radial_scatter(system.wavelength, system.surfaces, reach)


@lru_cache(maxsize=4)
def _radial_scatter(wavelength: float, surfaces: tuple[RoughSurface, ...], reach: float) -> RadialScatter:
    system = TruthSystem(wavelength, surfaces)
    knees = [wavelength * s.d / t.B for s in surfaces for t in s.terms]
    near = 1e-4 * min(knees) / math.sqrt(max(t.C for s in surfaces for t in s.terms))
    spacing = STRIDE * STEP
    log_r = math.log(near) + spacing * np.arange(math.ceil(math.log(1.3 * reach / near) / spacing) + 8)
    r = np.exp(log_r)
    with np.errstate(all="ignore"):  # what overflows has infinite noise, and is not used
        density, noise = unclipped(system, log_r)
        missing = missing_psf(system, r) / density
    ratio = 1.0 - missing
    worst = float(np.max(noise / ratio * (1.0 + np.abs(missing))))
    if not (0.0 < worst < NOISE):
        exact, noise = clipped(system, r)
        density = exact if exact.min() > 0.0 else _first_order(system, r)
        ratio = exact / density
        worst = float(np.max(noise))
    if not worst < NOISE:
        raise ArithmeticError(f"S(r) loses all but {worst:.1g} of itself to rounding")
    log_density, clip = (make_interp_spline(log_r, values, k=7) for values in (np.log(density), ratio))
    x, w = np.polynomial.legendre.leggauss(10)
    t = log_r[:-1, None] + 0.5 * spacing * (1.0 + x)
    shells = 0.5 * spacing * (2.0 * np.pi * np.exp(2.0 * t + log_density(t)) * clip(t)) @ w
    inside = np.cumsum(np.append(np.pi * r[0] ** 2 * density[0] * ratio[0], shells))
    total = -math.expm1(-math.fsum(phase_variance(wavelength, s) for s in surfaces))
    slope = float(log_density(log_r[-1], 1))
    tail = 2.0 * np.pi * math.exp(2.0 * log_r[-1]) * density[-1] * ratio[-1] / (-slope - 2.0)
    beyond = max(tail, 0.0) + 2.0 * float(-np.minimum(shells, 0.0).sum()) + 1e-300
    outside = beyond + np.append(np.cumsum(shells[::-1])[::-1], 0.0)
    energies = [make_interp_spline(log_r, np.log(energy), k=7) for energy in (inside, outside)]
    return RadialScatter(
        float(r[0]),
        *(CubicTable(spline, log_r[0], log_r[-1]) for spline in (log_density, clip, *energies)),
        worst,
        (total - tail - inside[-1]) / total,
    )


def _first_order(system: TruthSystem, r: np.ndarray) -> np.ndarray:
    """The spectra themselves, (K/(lambda d))^2 S2(r/(lambda d)) added up: the shape of S without multiple scatter."""
    total = np.zeros_like(r)
    for s in system.surfaces:
        for t in s.terms:
            knee = system.wavelength * s.d / t.B
            weight = (s.K * t.sigma) ** 2 * (t.C - 1.0) / (2.0 * np.pi * knee**2)
            total += weight * np.exp(-0.5 * (t.C + 1.0) * np.log1p((r / knee) ** 2))
    return total
