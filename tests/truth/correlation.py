"""1 - rho(u) of a K-correlation surface, rho(u) = 2^(1-nu)/Gamma(nu) u^nu K_nu(u), nu = (C-1)/2, u = 2 pi r/B."""

from __future__ import annotations

import mpmath
import numpy as np
from scipy.special import gamma, gammaln, jv, kve, yv


def decorrelation(u: np.ndarray, nu: float) -> np.ndarray:
    """1 - rho(u) in doubles, for u >= 0 (any shape) and 0 < nu <= 500.

    Good to 5e-12 relative wherever compared with ``decorrelation_mpmath`` (nu 0.01..500, u 1e-12..1e3), to 1e-13 for nu
    < 5. Three ranges: power series below u = 0.3, the Bessel function above, and for nu > 30 (where K_nu overflows) the
    integral 1/Gamma(nu) Int y^(nu-1) e^-y [1 - exp(-u^2/4y)] dy by a trapezoid rule in log y.
    """
    u = np.asarray(u, float)
    if nu > 30.0:
        width = 1.0 / np.sqrt(nu)
        y = nu * np.exp(np.linspace(-14.0 * width, 12.0 * width, 400))
        weight = np.exp(nu * np.log(y) - y - gammaln(nu))
        return np.einsum("k,...k->...", weight, -np.expm1(-0.25 * u[..., None] ** 2 / y)) / weight.sum()
    result = np.empty_like(u)
    small = u < 0.3
    v = np.minimum(u[~small], 800.0)  # rho is below 1e-300 there, and kve fails beyond 1e9
    log_rho = (1.0 - nu) * np.log(2.0) - gammaln(nu) + nu * np.log(v) + np.log(kve(nu, v)) - v
    result[~small] = -np.expm1(log_rho)
    result[small] = _series(u[small], nu)
    return result


def correlation_parts(u: np.ndarray, nu: float) -> tuple[np.ndarray, np.ndarray]:
    """1 - rho(u) and rho(u) in doubles for complex u, |arg u| < pi/2, and nu < 5: the first 1e-14 relative.

    So is the second, 5e-14 of it, where |u| > 0.3.
    """
    u = np.asarray(u, complex)
    left = np.zeros_like(u)
    size, large = np.abs(u), u.real > 700.0
    v = u[(size >= 0.3) & ~large]
    left[(size >= 0.3) & ~large] = np.exp((1.0 - nu) * np.log(2.0) - gammaln(nu) + nu * np.log(v) - v) * kve(nu, v)
    fallen = 1.0 - left
    # of steep spectra so little has fallen there that 1 - rho would lose two digits
    fallen[size < 2.0] = _near_whole(u[size < 2.0], nu)
    return fallen, np.where(size < 0.3, 1.0 - fallen, left)


def correlation_on_the_cut(x: np.ndarray, nu: float) -> tuple[np.ndarray, np.ndarray]:
    """Re(1 - rho) and Im rho at u = i x, x > 0: the first to absolute, the second to relative accuracy.

    rho(ix) = -(pi/2) 2^(1-nu)/Gamma(nu) x^nu [Y_nu(x) + i J_nu(x)].
    """
    scale = 0.5 * np.pi * np.exp((1.0 - nu) * np.log(2.0) - gammaln(nu)) * x**nu
    real = np.empty_like(x)
    small = x < 0.3
    real[~small] = 1.0 + scale[~small] * yv(nu, x[~small])
    real[small] = _near_whole(1j * x[small], nu).real
    return real, -scale * jv(nu, x)


def _near_whole(u: np.ndarray, nu: float) -> np.ndarray:
    """``_series`` for complex u: its mean over the circle in nu keeps both parts."""
    whole = round(nu)
    if whole >= 1 and abs(nu - whole) < 0.01:
        circle = nu + 0.03 * np.exp(2j * np.pi * (np.arange(48) + 0.5) / 48)
        return np.mean([_one_series(u, n) for n in circle], axis=0)
    return _one_series(u, nu)


def _series(u: np.ndarray, nu: float) -> np.ndarray:
    """1 - rho for small u, from the two series of K_nu.

    rho = Sum (u/2)^2k/(k! (1-nu)_k) - Gamma(1-nu)/Gamma(1+nu) (u/2)^2nu Sum (u/2)^2k/(k! (1+nu)_k).
    Either sum alone has poles at whole nu, their combination has none: near those it is replaced by its mean over a
    small circle in the complex plane of nu (Cauchy), on which little cancels.
    """
    return _near_whole(u.astype(complex), nu).real


def _one_series(u: np.ndarray, nu: complex) -> np.ndarray:
    zero = u == 0.0
    half = 0.5 * np.where(zero, 1.0, u)
    half_squared = np.where(zero, 0.0, half * half)
    power = np.where(zero, 0.0, np.exp(2.0 * nu * np.log(half)))
    coefficient = gamma(1.0 - nu) / gamma(1.0 + nu)
    total = coefficient * power
    even, odd = 1.0, coefficient * power
    for k in range(1, 16):
        even = even * half_squared / (k * (k - nu))
        odd = odd * half_squared / (k * (k + nu))
        total = total - even + odd
    return total


def decorrelation_mpmath(u: mpmath.mpf | mpmath.mpc, nu: mpmath.mpf | float) -> mpmath.mpf | mpmath.mpc:
    """1 - rho(u) at the working precision of mpmath (absolute), for complex u with |arg u| < pi/2."""
    if not u:
        return mpmath.mpf(0)
    nu = mpmath.mpf(nu)
    if 2 * nu == mpmath.floor(2 * nu) and 2 * nu % 2 == 1 and nu < 12:  # half-odd: a polynomial times exp(-u)
        n = int(nu - mpmath.mpf(1) / 2)
        fall = [mpmath.binomial(n + k, k) * mpmath.factorial(n) / mpmath.factorial(n - k) for k in range(n + 1)]
        polynomial = mpmath.fsum(c * (2 * u) ** (n - k) for k, c in enumerate(fall))
        return 1 - polynomial * mpmath.factorial(n) / mpmath.factorial(2 * n) * mpmath.exp(-u)
    return 1 - 2 ** (1 - nu) / mpmath.gamma(nu) * u**nu * bessel_k(nu, u)


def bessel_k(nu: mpmath.mpf | float, u: mpmath.mpf | mpmath.mpc) -> mpmath.mpf | mpmath.mpc:
    """K_nu(u), also at whole nu, where its two halves have poles: there the mean of the orders nu - e and nu + e.

    The mean errs by O(e^2), e^2 = 10^-(digits + 4), and costs a tenth of the logarithmic series.
    """
    if nu != mpmath.floor(nu):
        return mpmath.besselk(nu, u)
    digits = mpmath.mp.dps
    with mpmath.workdps(int(1.5 * digits) + 10):
        e = mpmath.mpf(10) ** (-(digits // 2 + 3))
        return mpmath.besselk(nu + e, u) if nu == 0 else (mpmath.besselk(nu - e, u) + mpmath.besselk(nu + e, u)) / 2
