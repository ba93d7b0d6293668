"""The normalised autocovariance of a K-correlation surface, on the real line and off it.

With nu = (C - 1)/2 and u = 2 pi r/B,  rho(u) = 2^(1-nu)/Gamma(nu) u^nu K_nu(u)  (a Matern covariance).
It is a gamma mixture of Gaussians, rho(u) = Int t^(nu-1) exp(-t) exp(-u^2/4t) dt/Gamma(nu), and the forms below
follow from that.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy import special

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LOG_HUGE = 600.0
_DEBYE_ORDER = 25.0  # from this nu on, Debye's expansion is good to 1e-13 where K_nu itself may overflow
_TERMS = 24  # of the power series in x <= nu/2: x^k/(k! nu^k) is below 1e-30 from here on
_SMALLEST = float(np.finfo(np.float64).tiny)
_TINY = 1e-150  # below this |u|, rho is 1 to the last bit and K_nu would overflow


def _log_prefactor(nu: float) -> float:
    return (1.0 - nu) * float(np.log(2.0)) - float(special.gammaln(nu))


def decorrelation(u: Real, nu: float) -> Real:
    """1 - rho(u) [1] for real ``u`` >= 0, same shape, without cancellation however small u is; see ``both_parts``."""
    return both_parts(u, nu)[1]


def autocovariance(u: Real, nu: float) -> Real:
    """rho(u) [1] for real ``u`` >= 0, same shape, relative accuracy kept in the tail; see ``both_parts``."""
    return both_parts(u, nu)[0]


def both_parts(u: Real, nu: float) -> tuple[Real, Real]:
    """rho(u) and 1 - rho(u) [1] for real ``u`` >= 0, each of the shape of u and with its own relative accuracy.

    By power series up to u^2 = 2 nu, where 1 - rho has grown to 0.4 at least, by K_nu beyond. The relative errors stay
    below 1e-12 max(1, nu/100, |ln rho|) for any u and 1e-6 <= nu <= 1000. What lies below the normal doubles is 0.
    """
    u = np.asarray(u, dtype=np.float64)
    rho, complement = np.ones_like(u), np.zeros_like(u)
    far = u > math.sqrt(2.0 * nu)
    near = (u > 0.0) & ~far
    rho[near], complement[near] = _by_power_series(u[near], nu)
    rho[far] = _by_bessel_function(u[far], nu)
    complement[far] = 1.0 - rho[far]
    return np.where(rho < _SMALLEST, 0.0, rho), np.where(complement < _SMALLEST, 0.0, complement)


def _by_power_series(u: Real, nu: float) -> tuple[Real, Real]:
    """Both parts for 0 < u <= sqrt(2 nu), from the two series of K_nu in x = u^2/4 (DLMF 10.25.2, 10.27.4),

    rho = sum_k A_k - sum_j B_j,  A_k = x^k/[k! (1-nu)_k],  B_j = Gamma(1-nu)/Gamma(1+nu) x^(nu+j)/[j! (1+nu)_j].

    With n the whole number next to nu, A_1 to A_(n-1) fall like 1/k! and no digit is lost in them; from A_n on each is
    taken together with a B. Where n is 0, the B_0 of the first pair is most of 1 - rho, and stands alone there.
    """
    n = round(nu)
    x = 0.25 * u * u
    head = np.zeros_like(u)  # A_1 + ... + A_(n-1), by Horner's rule
    for k in range(min(n, _TERMS) - 1, 0, -1):
        head = x / (k * (k - nu)) * (1.0 + head)
    if n >= _TERMS:
        return 1.0 + head, -head
    first, others = _pairs(u, nu)
    if n == 0:
        B_0 = math.gamma(1.0 - nu) / math.gamma(1.0 + nu) * 0.25**nu * u ** (2.0 * nu)
        return first + others, B_0 - others
    return 1.0 + (head + first + others), -(head + first + others)


def _pairs(u: Real, nu: float) -> tuple[Real, Real]:
    """A_n - B_0, and the sum of A_(n+j) - B_j from j = 1 on, at n the whole number next to nu.

    Both have a pole at nu = n, which cancels. With d = nu - n their ratio is B/A = exp(d e), where e = ln x + ... is
    regular; hence A - B = -(A d) e exprel(d e) = -(B d) e exprel(-d e), and A d, B d are regular too. The form with the
    larger of the two is taken, A for d >= 0. At d = 0 what remains is e, the logarithm of the whole orders.
    """
    n = round(nu)
    d = nu - n
    log_x = 2.0 * (np.log(u) - math.log(2.0))
    x = 0.25 * u * u
    power = min(float(n), nu)  # of x in A_n, or in B_0
    poleless = math.prod(i - nu for i in range(1, n)) if n else -1.0 / nu  # (1 - nu)_n/(-d)
    factor = 0.25**power * math.gamma(1.0 + max(-d, 0.0)) / (math.gamma(1.0 + power) * poleless)
    shift = _log_gamma_ratio(d) - sum(_log1p_ratio(d / i) / i for i in range(1, n + 1))
    pairs = []
    for j in range(1, _TERMS - n + 1):
        e = log_x + shift
        pairs.append(factor * e * special.exprel(abs(d) * e))
        factor = factor * x / (j * (j + nu) if d < 0.0 else (j + n) * (j - d))
        shift -= _log1p_ratio(-d / j) / j + _log1p_ratio(d / (n + j)) / (n + j)
    root = u**power  # its square by itself may leave the doubles where the product does not
    return root * pairs[0] * root, root * sum(pairs[1:]) * root


def _log_gamma_ratio(d: float) -> float:
    """[ln Gamma(1-d) - ln Gamma(1+d)]/d for |d| <= 1/2, by Taylor's series (DLMF 5.7.3): 2 gamma at d = 0."""
    odd = np.arange(3, 50, 2)
    return 2.0 * float(np.euler_gamma + special.zeta(odd) / odd @ d ** (odd - 1.0))


def _log1p_ratio(y: float) -> float:
    """ln(1 + y)/y, 1 at y = 0."""
    return math.log1p(y) / y if y else 1.0


def _by_bessel_function(u: Real, nu: float) -> Real:
    """The autocovariance for u >= sqrt(2 nu), where K_nu is far from overflow; by Debye's expansion for large nu."""
    z = np.minimum(u, 1e6)  # K_nu gives up beyond 1e9; rho is 0 long before
    if nu > _DEBYE_ORDER:
        return _by_normalised_debye(z, nu)
    return np.exp(_log_prefactor(nu) + nu * np.log(z) + np.log(special.kve(nu, z)) - z)


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
    return np.exp(_log_prefactor(nu) + nu * np.log(u) + log_k) * _debye_series(p, nu)


def _by_normalised_debye(u: Real, nu: float) -> Real:
    """The same for real u, divided by its own value at u = 0 in place of Gamma(nu), whose logarithm costs digits.

    With w = (1 + z^2)^(1/2) - 1:  rho = exp{-nu [w - ln(1 + w/2)]} (1 + w)^(-1/2) series(1/(1 + w))/series(1).
    """
    z2 = (u / nu) ** 2
    w = z2 / (1.0 + np.sqrt(1.0 + z2))
    series = _debye_series(1.0 / (1.0 + w), nu) / _debye_series(np.ones(1), nu)
    return np.exp(-nu * (w - np.log1p(0.5 * w))) / np.sqrt(1.0 + w) * series


def _debye_series(p: Any, nu: float) -> Any:
    return sum(poly(p) * (-1.0 / nu) ** k for k, poly in enumerate(_debye_polynomials()))


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
