"""S(r) and its encircled energy in doubles, on three contours, each radius by the one that loses the fewest digits.

``slant``: S = 4 Im Int q h(q) K0(-2 pi i q r) dq on rays at an angle, with h(0) subtracted or not: the core, and
whatever the next one cannot. ``cut``: the ray at 90 degrees, S = -4 Int t K0(2 pi r t) Im h(it) dt: the wing, however
faint. Both give the unclipped S, from which the clip at the horizon is subtracted (``horizon``). ``clipped``: the real
axis to the last clip and a slanted ray from there, where so much lies beyond the horizon that the difference is lost.
Trapezoids in the logarithm share their samples among all radii; the noise of each sum is what doubles leave of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, make_interp_spline
from scipy.special import hankel1e, j0, kve

from .correlation import correlation_complex, correlation_on_the_cut, decorrelation_complex
from .horizon import clip_frequencies, missing_psf
from .scatter import transfer_function
from .system import RoughSurface, TruthSystem, phase_variance

_STEP = 0.02  # in the logarithm of q; the rules converge like exp(-2 pi 0.15/step)
_CUBIC_STEP = 4e-3
_TINY = 1e-300
_STRIDE = 4  # steps between radii
_LOW, _HIGH = -23.0, 5.5  # of ln(2 pi |q| r)
_SLANTS = 0.12, 0.2, 0.3  # over pi
_ROUNDING = 4e-15  # of one sample, relative
_MOST_TURNS = 20.0  # h(it) oscillates like this argument, which the rule must resolve
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
    spacing = _STRIDE * _STEP
    log_r = math.log(near) + spacing * np.arange(math.ceil(math.log(1.3 * reach / near) / spacing) + 8)
    r = np.exp(log_r)
    with np.errstate(all="ignore"):  # what overflows has infinite noise, and is not used
        unclipped, noise = _unclipped(system, log_r)
        missing = missing_psf(system, r)
    ratio = 1.0 - missing / unclipped
    worst = float(np.max(noise / ratio * (1.0 + np.abs(missing) / unclipped)))
    if not (0.0 < worst < NOISE):
        unclipped, noise = _clipped(system, r)
        ratio = np.ones_like(r)
        if unclipped.min() <= 0.0:
            first_order = _first_order(system, r)
            unclipped, ratio = first_order, unclipped / first_order
        worst = float(np.max(noise / np.abs(ratio)))
    if not worst < NOISE:
        raise ArithmeticError(f"S(r) loses all but {worst:.1g} of itself to rounding")
    log_density, clip = (make_interp_spline(log_r, values, k=7) for values in (np.log(unclipped), ratio))
    x, w = np.polynomial.legendre.leggauss(10)
    t = log_r[:-1, None] + 0.5 * spacing * (1.0 + x)
    shells = 0.5 * spacing * (2.0 * np.pi * np.exp(2.0 * t + log_density(t)) * clip(t)) @ w
    inside = np.cumsum(np.append(np.pi * r[0] ** 2 * unclipped[0] * ratio[0], shells))
    total = -math.expm1(-math.fsum(phase_variance(wavelength, s) for s in surfaces))
    slope = float(log_density(log_r[-1], 1))
    tail = 2.0 * np.pi * math.exp(2.0 * log_r[-1]) * unclipped[-1] * ratio[-1] / (-slope - 2.0)
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


def _exponents(system: TruthSystem, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums over all terms of K^2 sigma^2 (1 - rho) and of K^2 sigma^2 rho at complex q."""
    fallen, left = np.zeros_like(q), np.zeros_like(q)
    for s in system.surfaces:
        for t in s.terms:
            u = 2.0 * np.pi * system.wavelength * s.d * q / t.B
            part = decorrelation_complex(u, 0.5 * (t.C - 1.0))
            far = np.abs(u) > 1.0
            rho = 1.0 - part
            v = u[far & (u.real < 700.0)]
            rho[far] = 0.0
            rho[far & (u.real < 700.0)] = correlation_complex(v, 0.5 * (t.C - 1.0))
            fallen += (s.K * t.sigma) ** 2 * part
            left += (s.K * t.sigma) ** 2 * rho
    return fallen, left


def _log_height(system: TruthSystem) -> float:
    """Sum of K^2 C(0) - g, the logarithm of the unclipped OTF at q = 0."""
    return math.fsum(
        (s.K * t.sigma) ** 2 * beyond
        for s in system.surfaces
        for t, beyond in zip(s.terms, s.beyond(system.wavelength), strict=True)
    )


def _unclipped(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S, relative noise) of the unclipped S, each radius from the contour of least noise."""
    n = np.arange(math.floor(_LOW / _STEP), math.ceil(_HIGH / _STEP) + 1)  # 2 pi |q| r = exp(n step)
    shift = _STRIDE * (len(log_r) - 1)
    k = np.arange(n[0] - shift, n[-1] + 1)
    size = np.exp(k * _STEP - log_r[0]) / (2.0 * np.pi)  # |q|
    floor = math.fsum(phase_variance(system.wavelength, s) for s in system.surfaces)
    candidates = []
    for slant in _SLANTS:
        turn = np.exp(1j * np.pi * slant)
        z = -1j * turn * np.exp(n * _STEP)
        kernel = kve(0, z) * np.exp(-z)
        q = turn * size
        fallen, left = _exponents(system, q)
        subtracted = math.exp(_log_height(system)) * np.expm1(-fallen)
        for h in (subtracted, math.exp(-floor) * np.expm1(left)):
            candidates.append(_sums(4.0 * _STEP * (q * q * h), kernel, len(log_r)))
    candidates.append(_on_the_cut(system, size, np.exp(n * _STEP), len(log_r)))
    value, noise = (np.array(part) for part in zip(*candidates, strict=True))
    noise = np.where(np.isfinite(noise) & (value > 0.0), noise / np.abs(value), np.inf)
    best = np.argmin(noise, axis=0)[None]
    return np.take_along_axis(value, best, 0)[0], np.take_along_axis(noise, best, 0)[0]


def _sums(samples: np.ndarray, kernel: np.ndarray, radii: int) -> tuple[np.ndarray, np.ndarray]:
    """Im Sum samples x kernel at every radius, and its rounding."""
    shifted = np.lib.stride_tricks.sliding_window_view(samples, len(kernel))[::-1][::_STRIDE][:radii]
    return (shifted @ kernel).imag, _ROUNDING * (np.abs(shifted) @ np.abs(kernel))


def _on_the_cut(system: TruthSystem, t: np.ndarray, x: np.ndarray, radii: int) -> tuple[np.ndarray, np.ndarray]:
    """S from Im h(it), and its noise: the rounding, and the smallest sample beyond the peak, where the sum must end."""
    real, imaginary = np.zeros_like(t), np.zeros_like(t)
    widest = max(system.wavelength * s.d / term.B for s in system.surfaces for term in s.terms)
    resolved = 2.0 * np.pi * widest * t < _MOST_TURNS
    for s in system.surfaces:
        for term in s.terms:
            fallen, part = correlation_on_the_cut(
                2.0 * np.pi * system.wavelength * s.d * t / term.B, 0.5 * (term.C - 1.0)
            )
            real -= (s.K * term.sigma) ** 2 * fallen
            imaginary += (s.K * term.sigma) ** 2 * part
    samples = -4.0 * _STEP * t * t * np.exp(_log_height(system) + real) * np.sin(imaginary)
    # h(it) swings between huge and tiny: the envelope of what has been is no accident
    envelope = np.minimum(np.maximum.accumulate(np.abs(imaginary)), 1.0)
    bound = 4.0 * _STEP * t * t * np.exp(_log_height(system) + np.maximum.accumulate(np.abs(real))) * envelope
    bound[~resolved] = np.inf
    kernel = kve(0, x) * np.exp(-x)
    shifted, bounds = (
        np.lib.stride_tricks.sliding_window_view(v, len(kernel))[::-1][::_STRIDE][:radii] for v in (samples, bound)
    )
    value, noise = np.empty(radii), np.empty(radii)
    peak = int(np.searchsorted(x, 1.0))
    for m in range(radii):
        size = bounds[m] * kernel
        finite = np.isfinite(size[peak:])
        end = peak + int(np.argmin(np.where(finite, size[peak:], np.inf)))
        value[m] = np.sum(shifted[m, :end] * kernel[:end])
        noise[m] = _ROUNDING * np.sum(size[:end]) + 100.0 * size[end]
    return value, noise


def _clipped(system: TruthSystem, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S, relative noise) with the clip: the real axis up to the last q_c, and from there a ray at 45 degrees."""
    clips = sorted(clip_frequencies(system.wavelength, system.surfaces))
    first = min(clips[0], clips[-1] / 24.0)
    edges = np.unique([*clips, *np.linspace(first, clips[-1], 41), *(first * 0.5 ** np.arange(1, 40)), 0.0])
    x, w = np.polynomial.legendre.leggauss(14)
    half = 0.5 * np.diff(edges)[:, None]
    q, weight = (edges[:-1, None] + half + half * x).ravel(), (half * w).ravel()
    # less its value at the last clip, whose transform is known, there is no jump to integrate
    h = transfer_function(system, q) - math.exp(-math.fsum(phase_variance(system.wavelength, s) for s in system.surfaces))
    near = 2.0 * np.pi * q * weight * h
    J = j0(2.0 * np.pi * np.outer(r, q))
    value, noise = J @ near, np.abs(J) @ np.abs(near)
    turn = np.exp(0.2j * np.pi)
    v = np.arange(-52.0, 60.0, 0.04)
    value_far, noise_far = np.empty_like(r), np.empty_like(r)
    log_height = _log_height(system)
    floor = math.fsum(phase_variance(system.wavelength, s) for s in system.surfaces)
    for i, radius in enumerate(r):
        s = np.exp(v) / (2.0 * np.pi * radius)
        used = np.exp(v) * math.sin(0.2 * math.pi) < 45.0
        qq = clips[-1] + turn * s[used]
        fallen, left = _exponents(system, qq)
        h = np.where(left.real > 1.0, np.exp(log_height - fallen) - math.exp(-floor), math.exp(-floor) * np.expm1(left))
        z = 2.0 * np.pi * qq * radius
        terms = 2.0 * np.pi * 0.04 * qq * h * hankel1e(0, z) * np.exp(1j * z) * turn * s[used]
        value_far[i], noise_far[i] = terms.sum().real, np.abs(terms).sum()
    total = value + value_far
    return total, _ROUNDING * (noise + noise_far) / np.abs(total)
