"""The normalised autocovariance of a K-correlation surface, on the real line and off it.

With nu = (C - 1)/2 and u = 2 pi r/B,  rho(u) = 2^(1-nu)/Gamma(nu) u^nu K_nu(u)  (a Matern covariance).
It is a gamma mixture of Gaussians, rho(u) = Int t^(nu-1) exp(-t) exp(-u^2/4t) dt/Gamma(nu), and the forms below
follow from that.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy import special

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LOG_HUGE = 600.0
_GAMMA_STEP = 0.3  # exp(-pi^2/0.3) = 5e-15
_DEBYE_ORDER = 25.0  # from this nu on, Debye's expansion is good to 1e-13 where K_nu itself may overflow
_TINY = 1e-150  # below this |u|, rho is 1 to the last bit and K_nu would overflow


def _log_prefactor(nu: float) -> float:
    return (1.0 - nu) * float(np.log(2.0)) - float(special.gammaln(nu))


def decorrelation(u: Real, nu: float) -> Real:
    """1 - rho(u), positive and without cancellation however small u is, same shape as ``u`` >= 0. Valid for nu > 0."""
    u = np.asarray(u, dtype=np.float64)
    out = np.empty_like(u)
    near = u <= 1.0
    out[near] = _decorrelation_near(u[near], nu)
    out[~near] = 1.0 - _autocovariance_far(u[~near], nu)
    return out


def autocovariance(u: Real, nu: float) -> Real:
    """rho(u) for real u >= 0, same shape, 1 at u = 0, relative accuracy kept in the tail. Valid for nu > 0."""
    u = np.asarray(u, dtype=np.float64)
    out = np.empty_like(u)
    near = u <= 1.0
    out[near] = 1.0 - _decorrelation_near(u[near], nu)
    out[~near] = _autocovariance_far(u[~near], nu)
    return out


def _decorrelation_near(u: Real, nu: float) -> Real:
    """1 - rho = Int P(nu, t) y exp(-y) d ln t with y = u^2/(4 t), P the regularised incomplete gamma function.

    The gamma mixture integrated by parts: every term is positive. The trapezoid rule in ln t converges like
    exp(-pi^2/step), below rounding at the step used.
    """
    positive = u[u > 0.0]
    if positive.size == 0:
        return np.zeros_like(u)
    # y exp(-y) is below rounding for y > 45; beyond t = 1 it falls like 1/t, beyond y = 1 likewise
    t = np.exp(np.arange(np.log(positive.min() ** 2 / 180.0), 40.0, _GAMMA_STEP))
    cumulative = special.gammainc(nu, t)
    out = np.zeros_like(u)
    y = np.divide.outer(0.25 * positive**2, t)
    out[u > 0.0] = _GAMMA_STEP * ((y * np.exp(-y)) @ cumulative)
    return out


def _autocovariance_far(u: Real, nu: float) -> Real:
    z = np.minimum(u, 1e6)  # K_nu gives up beyond 1e9; rho is 0 long before
    if nu > _DEBYE_ORDER:
        return _by_debye(z.astype(np.complex128), nu).real
    with np.errstate(over="ignore", under="ignore"):
        rho: Real = np.exp(_log_prefactor(nu) + nu * np.log(z) + np.log(special.kve(nu, z)) - z)
    return rho


def autocovariance_off_axis(u: Complex, nu: float) -> Complex:
    """rho(u) for complex u with Re u > 0, same shape."""
    inside = np.abs(u) > _TINY
    z = np.where(inside, u, 1.0)
    if nu > _DEBYE_ORDER:
        return np.where(inside, _by_debye(z, nu), 1.0)
    value = np.exp(_log_prefactor(nu)) * z**nu * special.kv(nu, z)
    return np.where(inside, value, 1.0)


def autocovariance_on_cut(x: Real, nu: float) -> tuple[Real, Real]:
    """Real and imaginary part of rho(i x) for x > 0, each with its own full relative accuracy.

    rho(i x) = -(pi/2) 2^(1-nu)/Gamma(nu) x^nu [Y_nu(x) + i J_nu(x)]. The imaginary part, of order x^(2 nu), is what
    the far wing of the scatter is made of; taken from J_nu alone it loses nothing to the real part. Where Y_nu
    overflows, the real part is that of exp(x^2/4 nu), the Gaussian limit.
    """
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        scale = -0.5 * np.pi * np.exp(_log_prefactor(nu) + nu * np.log(x))
        real = scale * special.yv(nu, x)
        imaginary = scale * special.jv(nu, x)
    usable = np.isfinite(real) & (x > _TINY)
    limit = np.exp(np.minimum(x**2 / (4.0 * nu), _LOG_HUGE))
    return np.where(usable, real, limit), np.where(np.isfinite(imaginary), imaginary, 0.0)


def _by_debye(u: Complex, nu: float) -> Complex:
    """rho(u) by Debye's uniform expansion of K_nu(nu z) in powers of 1/nu, z = u/nu (DLMF 10.41.4)."""
    z = u / nu
    root = np.sqrt(1.0 + z * z)
    log_k = -nu * (root + np.log(z / (1.0 + root))) - 0.5 * np.log(root) + 0.5 * np.log(0.5 * np.pi / nu)
    p = 1.0 / root
    series = sum(poly(p) * (-1.0 / nu) ** k for k, poly in enumerate(_debye_polynomials()))
    return np.exp(_log_prefactor(nu) + nu * np.log(u) + log_k) * series


@cache
def _debye_polynomials() -> tuple[Polynomial, ...]:
    """U_0 to U_8 of Debye's expansion, by their recurrence (DLMF 10.41.9)."""
    U = [Polynomial([1.0])]
    for _ in range(8):
        U.append(
            Polynomial([0.0, 0.0, 0.5, 0.0, -0.5]) * U[-1].deriv()
            + (Polynomial([1.0, 0.0, -5.0]) * U[-1]).integ() / 8.0
        )
    return tuple(U)
