"""The unclipped S(r) on a slanted ray of the complex q plane, in mpmath: any dynamic range, core and wing alike.

With J0 = Re H0 (Hankel's first) and H0(z) = (2/(pi i)) K0(-i z), turning q = t exp(i a), 0 < a < pi/2, gives

    S(r) = 4 Im Int q [h(q) - h(0)] K0(-2 pi i q r) dq     along the ray.

Subtracting h(0) is free, as Int q K0(-2 pi i q r) dq is real, and removes the largest cancellation. On the ray both
Bessel functions decay, so the trapezoid rule in ln t converges exponentially: error exp(-2 pi b/step) with b the angle
to the nearest direction where the integrand grows. What is left of the cancellation is paid for in digits, and counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import mpmath
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from .correlation import bessel_k, decorrelation_mpmath
from .system import TruthSystem, phase_variance


def unclipped_exponent(wavelength: float, surfaces: tuple, q: mpmath.mpc | mpmath.mpf) -> mpmath.mpc | mpmath.mpf:
    """Sum over surfaces of K^2 C(lambda d q) - K^2 C(0), at mpmath's working precision, for complex q."""
    return -mpmath.fsum(
        (mpmath.mpf(s.K) * t.sigma) ** 2
        * decorrelation_mpmath(2 * mpmath.pi * mpmath.mpf(wavelength) * s.d * q / t.B, (mpmath.mpf(t.C) - 1) / 2)
        for s in surfaces
        for t in s.terms
    )


def unclipped_height(wavelength: float, surfaces: tuple) -> mpmath.mpf:
    """exp(sum_j [K^2 C(0) - g]): the unclipped OTF_S at q = 0; above 1 by the light beyond the horizon."""
    return mpmath.exp(
        mpmath.fsum(
            (mpmath.mpf(s.K) * t.sigma) ** 2
            * (1 + (mpmath.mpf(t.B) * s.index / wavelength) ** 2) ** ((1 - mpmath.mpf(t.C)) / 2)
            for s in surfaces
            for t in s.terms
        )
    )


def scatter_psf_mpmath(system: TruthSystem, r: float, digits: int = 12, slant: float = 0.2) -> mpmath.mpf:
    """The unclipped S(r) [1/mm^2] to ``digits`` relative, on the ray at angle pi * ``slant``.

    Checked to 1e-11 between slants 0.15 and 0.3 (C = 8 at 0.01 and 1e9 times lambda d/B) and with the closed series at
    C = 2 (0.01 to 1e9), 1e-10 with the panels (another method; C = 1.2, 3, 6.5). The clip at the horizon is not in it:
    subtract ``horizon.missing_psf``. Half a second a point, tens of seconds for C = 8 in the far wing.
    """
    core = min(system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms)
    plan = _Plan.of(system.wavelength, system.surfaces, [r / core], digits, slant)
    return plan.integrate(system.wavelength, system.surfaces, [r])[0]


@dataclass(frozen=True)
class _Plan:
    """How finely to sample the ray: working digits, step in ln t, range of ln(2 pi r t), angle/pi."""

    digits: int
    dps: int
    step: float
    low: float
    high: float
    slant: float

    @classmethod
    def of(cls, wavelength: float, surfaces: tuple, reach: list[float], digits: int, slant: float | None) -> _Plan:
        """The plan for radii at ``reach`` times the smallest knee lambda d/B."""
        slopes = [t.C for s in surfaces for t in s.terms]
        g = sum(phase_variance(wavelength, s) for s in surfaces)
        slant = slant or (0.2 if g < 5.0 else 0.125)
        decades = max(0.0, math.log10(max(reach))) + 0.5
        inward = max(0.0, -math.log10(min(reach)))
        rule = digits + 4 + max(2 * inward, max(0.0, max(slopes) - 3.0) * decades)
        dps = int(digits + 10 + max(2 * inward, (max(slopes) - 1.0) * decades)) + 4
        ln10 = math.log(10.0)
        strip = 0.75 * math.pi * min(slant, (0.5 if g < 5.0 else 0.25) - slant)
        low = -ln10 * rule / min(4.0, 1.0 + min(slopes))
        high = math.log(ln10 * (rule + 3) / math.sin(math.pi * slant))
        return cls(digits, dps, 2.0 * math.pi * strip / (ln10 * rule), low, high, slant)

    def integrate(self, wavelength: float, surfaces: tuple, radii: list[float], stride: int = 0) -> list[mpmath.mpf]:
        """S at ``radii``; with ``stride`` the radii lie that many steps apart in ln r, and share one set of samples."""
        with mpmath.workdps(self.dps):
            turn = mpmath.expjpi(mpmath.mpf(self.slant))
            step = mpmath.mpf(self.step)
            first, last = math.floor(self.low / self.step), math.ceil(self.high / self.step)
            z = [turn * mpmath.exp(n * step) for n in range(first, last + 1)]
            kernel = [bessel_k(0, -1j * v) for v in z]
            height = unclipped_height(wavelength, surfaces)

            def sample(q: mpmath.mpc) -> mpmath.mpc:  # q^2 [h(q) - h(0)]
                return q * q * height * mpmath.expm1(unclipped_exponent(wavelength, surfaces, q))

            # 2 pi q r = turn exp(n step): at radius number m, the samples of radius 0 shifted by m strides
            shifts = [stride * m for m in range(len(radii))] if stride else [0]
            scale = turn / (2 * mpmath.pi * radii[0])
            samples = [sample(scale * mpmath.exp(k * step)) for k in range(first - shifts[-1], last + 1)]
            largest = max(abs(k * v * v) for k, v in zip(kernel, z, strict=True))
            noise = mpmath.mpf(10) ** (self.digits - self.dps) * height * largest / (2 * mpmath.pi * radii[0]) ** 2
            results = []
            for shift in shifts:
                start = shifts[-1] - shift
                used = samples[start : start + len(kernel)]
                value = 4 * step * mpmath.fdot(used, kernel).imag
                if not abs(value) > noise * mpmath.exp(-2 * shift * step):
                    raise ArithmeticError("cancellation: more digits are needed")
                results.append(value)
            return results


@dataclass(frozen=True)
class ScatterTable:
    """ln S, and ln of the energy outside R, as splines of degree 7 in ln r; ``total`` = inside + outside [1].

    ``total`` is built up by integration; that it equals h(0) to 1e-11 (where the power-law tail beyond the last radius
    is exact) is a check and not an assumption.
    """

    first: float
    last: float
    log_psf: BSpline
    log_outside: BSpline
    total: float

    def _power_law(self, spline: BSpline, r: np.ndarray) -> np.ndarray:
        log_r = np.log(np.maximum(r, self.first))
        end = math.log(self.last)
        slope = float(spline(end, 1))
        return np.exp(spline(np.minimum(log_r, end)) + slope * np.maximum(0.0, log_r - end))

    def psf(self, r: np.ndarray) -> np.ndarray:
        """Unclipped S(r) [1/mm^2]; inside the first radius ln S is quadratic in r."""
        r = np.asarray(r, float)
        bend = 0.5 * float(self.log_psf(math.log(self.first), 1)) * (np.minimum(r / self.first, 1.0) ** 2 - 1.0)
        return self._power_law(self.log_psf, r) * np.exp(bend)

    def outside(self, r: np.ndarray) -> np.ndarray:
        """Energy of the unclipped S beyond ``r`` [mm], relative accuracy (up to the constant in the last tail)."""
        r = np.asarray(r, float)
        centre = self.total - np.pi * r * r * self.psf(np.minimum(r, self.first))
        return np.where(r < self.first, centre, self._power_law(self.log_outside, r))

    def inside(self, r: np.ndarray) -> np.ndarray:
        """Energy of the unclipped S within ``r`` [mm], absolute accuracy."""
        return self.total - self.outside(r)


@lru_cache(maxsize=32)
def scatter_table(wavelength: float, surfaces: tuple) -> ScatterTable:
    """The table from 1e-3 of the smallest knee lambda d/B to ten times the largest d: seconds, minutes for C > 9.

    It ends earlier where S has fallen by 1e-45: what follows is continued as a power law.
    """
    knees = [wavelength * s.d / t.B for s in surfaces for t in s.terms]
    slopes = [t.C for s in surfaces for t in s.terms]
    g = sum(phase_variance(wavelength, s) for s in surfaces)
    near = 1e-3 * min(knees) / math.sqrt(max(slopes))
    faint = 10.0 ** (45.0 / (min(slopes) + 1.0)) * (1.0 + g) * max(knees)
    far = min(max(10.0 * max(s.d for s in surfaces), 1e4 * max(knees)), faint)
    plan = _Plan.of(wavelength, surfaces, [near / min(knees), far / min(knees)], 12, None)
    stride = max(1, round(0.08 / plan.step))
    log_r = math.log(near) + stride * plan.step * np.arange(math.ceil(math.log(far / near) / (stride * plan.step)) + 1)
    radii = [float(v) for v in np.exp(log_r)]
    log_s = np.array([float(mpmath.log(v)) for v in plan.integrate(wavelength, surfaces, radii, stride)])
    log_psf = make_interp_spline(log_r, log_s, k=7)
    x, w = np.polynomial.legendre.leggauss(12)
    half = 0.5 * stride * plan.step
    t = log_r[:-1, None] + half * (1.0 + x)
    shells = half * (2.0 * np.pi * np.exp(2.0 * t + log_psf(t))) @ w
    tail = 2.0 * np.pi * math.exp(2.0 * log_r[-1] + log_s[-1]) / (-float(log_psf(log_r[-1], 1)) - 2.0)
    outside = np.cumsum(np.append(shells, tail)[::-1])[::-1]
    total = float(outside[0] + np.pi * math.exp(2.0 * log_r[0] + log_s[0]))
    return ScatterTable(radii[0], radii[-1], log_psf, make_interp_spline(log_r, np.log(outside), k=7), total)
