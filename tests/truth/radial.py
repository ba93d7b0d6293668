"""S(r) and its encircled energy, tabled once per system in doubles: milliseconds where ``contour`` takes seconds.

S comes from ``contours``, without the clip at the horizon, which is then subtracted (``horizon``), or with it,
whichever loses fewer digits. Energies are shells added up, from the centre and from the outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline

from .contours import STEP, clipped, unclipped
from .horizon import missing_psf
from .system import RoughSurface, TruthSystem, phase_variance

_SHIFT = 45  # a double has 52 bits of mantissa: 128 parts to the octave
_MASK = (1 << _SHIFT) - 1
NOISE = 1e-9  # the largest relative noise handed out


class SquareTable:
    """A smooth function of a radius as quintics in its square, on even parts of each octave; constant beyond its ends.

    A double's exponent and leading bits number its part, the other bits are the place in it: no logarithm is taken.
    Each quintic goes through six Chebyshev nodes: 1e-12 of the function.
    """

    def __init__(self, function: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> None:
        """``function`` of ln r, tabled from radius ``low`` to ``high``."""
        first, last = (int(part) for part in np.array([low**2, high**2]).view(np.int64) >> _SHIFT)
        ends = (np.arange(first, last + 2) << _SHIFT).view(float)
        node = 0.5 - 0.5 * np.cos(np.pi * (np.arange(6) + 0.5) / 6)
        square = ends[:-1] + np.diff(ends) * node[:, None]
        values = function(np.clip(0.5 * np.log(square), math.log(low), math.log(high)))
        self._coefficients = np.ascontiguousarray(np.linalg.solve(np.vander(node), values))
        self._offset, self._first, self._last = first, low**2, high**2

    def __call__(self, square: np.ndarray) -> np.ndarray:
        bits = np.clip(square, self._first, self._last).view(np.int64)
        index = (bits >> _SHIFT) - self._offset
        place = (bits & _MASK) * (1.0 / (_MASK + 1))
        result = self._coefficients[0].take(index)
        for coefficient in self._coefficients[1:]:
            result *= place
            result += coefficient.take(index)
        return result


@dataclass(frozen=True)
class RadialScatter:
    """Tables of S, and of the energies within r and, but for a constant, beyond; ``core`` is the narrowest knee [mm].

    ``worst`` is the largest relative noise plus error between the tabled radii up to the reach, ``closure`` what the
    shells and the tail miss of 1 - exp(-sum g).
    """

    core: float
    first: float
    psf: SquareTable
    within: SquareTable
    outside: SquareTable
    worst: float
    closure: float

    def inside(self, square: np.ndarray) -> np.ndarray:
        """Energy within a radius of given ``square`` [mm^2]; relative accuracy."""
        return self.within(square) * np.minimum(square / self.first**2, 1.0)


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
    # ln S has branch points off the real axis, at the zeros of S, where a Gaussian core meets a far lower wing
    log_r = math.log(near) + STEP * np.arange(math.ceil(math.log(1.3 * reach / near) / STEP) + 8)
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
    worst += _between(log_r, np.log(density), reach) + _between(log_r, ratio, reach)
    if not worst < NOISE:
        raise ArithmeticError(f"S(r) is known to no better than {worst:.1g} of itself")
    log_density, clip = (make_interp_spline(log_r, values, k=7) for values in (np.log(density), ratio))
    x, w = np.polynomial.legendre.leggauss(10)
    t = log_r[:-1, None] + 0.5 * STEP * (1.0 + x)
    shells = 0.5 * STEP * (2.0 * np.pi * np.exp(2.0 * t + log_density(t)) * clip(t)) @ w
    inside = np.cumsum(np.append(np.pi * r[0] ** 2 * density[0] * ratio[0], shells))
    total = -math.expm1(-math.fsum(phase_variance(wavelength, s) for s in surfaces))
    slope = float(log_density(log_r[-1], 1))
    tail = 2.0 * np.pi * math.exp(2.0 * log_r[-1]) * density[-1] * ratio[-1] / (-slope - 2.0)
    # a constant that no rectangle sees: the tail, or on a plateau, where that says nothing, as much as a shell, so that
    # the logarithm stays smooth up to the end
    end = 2.0 * np.pi * math.exp(2.0 * log_r[-1]) * density[-1] * abs(ratio[-1]) / max(-slope - 2.0, 1.0)
    beyond = end + 2.0 * float(-np.minimum(shells, 0.0).sum()) + 1e-300
    outside = beyond + np.append(np.cumsum(shells[::-1])[::-1], 0.0)
    log_inside, log_outside = (make_interp_spline(log_r, np.log(energy), k=7) for energy in (inside, outside))
    functions = (
        lambda t: np.exp(log_density(t)) * clip(t),
        lambda t: np.exp(log_inside(t)),
        lambda t: np.exp(log_outside(t)),
    )
    return RadialScatter(
        float(min(knees)),
        float(r[0]),
        *(SquareTable(function, float(r[0]), float(r[-1])) for function in functions),
        worst,
        (total - tail - inside[-1]) / total,
    )


def _between(log_r: np.ndarray, values: np.ndarray, reach: float) -> float:
    """The largest error, up to ``reach``, of a spline of degree 7 between its nodes, some of which lie beyond.

    Error ~ spacing^8: from that of every other node. In its last intervals, which have no knots of their own, a spline
    errs a thousand times as much as inside; that halves from node to node, and the nodes beyond keep it out of reach.
    """
    coarse = make_interp_spline(log_r[::2], values[::2], k=7)
    missed = np.abs(coarse(log_r) - values)[log_r <= math.log(reach)]
    return float(np.max(missed)) / 2.0**8


def _first_order(system: TruthSystem, r: np.ndarray) -> np.ndarray:
    """The spectra themselves, (K/(lambda d))^2 S2(r/(lambda d)) added up: the shape of S without multiple scatter."""
    total = np.zeros_like(r)
    for s in system.surfaces:
        for t in s.terms:
            knee = system.wavelength * s.d / t.B
            weight = (s.K * t.sigma) ** 2 * (t.C - 1.0) / (2.0 * np.pi * knee**2)
            total += weight * np.exp(-0.5 * (t.C + 1.0) * np.log1p((r / knee) ** 2))
    return total
