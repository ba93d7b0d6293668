"""The surface functions from their definitions, with as many digits as it takes (mpmath)."""

from __future__ import annotations

import mpmath
from mpmath import mpf
from truth.contour import scatter_psf_mpmath
from truth.system import RoughSurface, Term, TruthSystem

BEYOND = 1e5  # rho(u) is below 1e-4000 from here on, for nu up to 1000


def both_parts(u: mpf | float, nu: mpf | float) -> tuple[mpf, mpf]:
    """rho(u) and 1 - rho(u) to 30 digits at least, for u >= 0 and 1e-6 <= nu <= 1000."""
    if u == 0 or u > BEYOND:
        return (mpf(1), mpf(0)) if u == 0 else (mpf(0), mpf(1))
    with mpmath.workdps(110):
        if u < 2:
            complement = _by_series(mpf(u), mpf(nu))
            return 1 - complement, complement
        rho = _by_integral(mpf(u), mpf(nu))
        return rho, 1 - rho


def _by_series(u: mpf, nu: mpf) -> mpf:
    """1 - rho = Gamma(1-nu)/Gamma(1+nu) x^nu S(nu) - S(-nu) + 1, S(nu) = sum_k x^k/[k! (1+nu)_k], x = u^2/4.

    At whole nu, where the parts have poles, the mean of nu +- 1e-40: their error of order 1e-80 is smooth in nu.
    """
    shift = mpf(10) ** -40
    orders = [nu - shift, nu + shift] if nu == mpmath.floor(nu) else [nu]
    x = u * u / 4
    total = mpf(0)
    for order in orders:
        regular, singular = _tail_of_series(x, -order), 1 + _tail_of_series(x, order)
        total += mpmath.gamma(1 - order) / mpmath.gamma(1 + order) * x**order * singular - regular
    return total / len(orders)


def _tail_of_series(x: mpf, nu: mpf) -> mpf:
    """S(nu) - 1, for x <= 1; past k = -nu, where 1 + nu + k may be next to 0."""
    total, term, k = mpf(0), mpf(1), 0
    while k <= -nu + 1 or abs(term) > mpf(10) ** -110 * abs(total):
        k += 1
        term *= x / (k * (k + nu))
        total += term
    return total


def _by_integral(u: mpf, nu: mpf) -> mpf:
    """rho = 2^(1-nu)/Gamma(nu) u^nu K_nu(u), K_nu = (1/2) Int exp(nu t - u cosh t) dt over all t, by trapezoids.

    The integrand is analytic and falls like exp(-exp|t|): with 16 steps and more to its width the error is below 1e-40.
    """
    with mpmath.workdps(60):
        peak = mpmath.asinh(nu / u)
        step = min(mpf("0.08"), mpf("0.4") / mpmath.sqrt(mpmath.hypot(u, nu)))
        total = mpf(0)
        for direction, k in ((1, 0), (-1, -1)):
            value = mpf(1)
            while value > mpf(10) ** -50:
                t = peak + k * step
                value = mpmath.exp(nu * (t - peak) - u * (mpmath.cosh(t) - mpmath.cosh(peak)))
                total += value
                k += direction
        log_scale = nu * peak - u * mpmath.cosh(peak) + (1 - nu) * mpmath.log(2) - mpmath.loggamma(nu)
        return mpmath.exp(log_scale + nu * mpmath.log(u)) * total * step / 2


def transfer(sigma: float, B: float, C: float, wavelength: float, r: float) -> tuple[mpf, mpf, mpf]:
    """sigma_rel, TIS and H(r) of a mirror with one term at normal incidence, to 30 digits at least."""
    with mpmath.workdps(60):
        K, nu = 4 * mpmath.pi / mpf(wavelength), (mpf(C) - 1) / 2
        # 60 digits hold 1 - (1 + b^2)^-nu for b >= 1e-13 and the product with nu >= 1e-6
        share = -mpmath.expm1(-nu * mpmath.log1p((mpf(B) / mpf(wavelength)) ** 2))
        g = (K * mpf(sigma)) ** 2 * share
        rho, complement = both_parts(2 * mpmath.pi * mpf(r) / mpf(B), nu)
        a = (K * mpf(sigma)) ** 2
        exponent = a * rho - g if rho < complement else a * (1 - share) - a * complement
        return mpf(sigma) * mpmath.sqrt(share), -mpmath.expm1(-g), mpmath.exp(min(mpf(0), exponent))


def mirror(sigma: float, B: float, C: float, wavelength: float) -> TruthSystem:
    """The mirror as the tests' other truth takes it, at a distance of 1 mm: S per mm^2 is then the BSDF per sr."""
    K = float(4 * mpmath.pi / mpf(wavelength))
    return TruthSystem(wavelength, (RoughSurface(K, 1.0, (Term(sigma, B, C),)),))


def bsdf(beta: float, sigma: float, B: float, C: float, wavelength: float) -> mpf:
    """F(beta/lambda)/lambda^2 [1/sr]: in closed form for even C, else to 12 digits on a ray of the complex plane."""
    if C % 2.0 == 0.0:
        return _bsdf_by_scatterings(beta, sigma, B, C, wavelength)
    return scatter_psf_mpmath(mirror(sigma, B, C, wavelength), beta)


def _polynomial(C: float) -> list[mpf]:
    """Coefficients of rho exp(u) for even C, m = C/2 - 1: m!/(2m)! sum_k (m+k)!/[k! (m-k)!] (2u)^(m-k)."""
    m, factorial = int(C) // 2 - 1, mpmath.factorial
    scale = factorial(m) / factorial(2 * m)
    return [scale * factorial(2 * m - k) / (factorial(m - k) * factorial(k)) * 2**k for k in range(m + 1)]


def _bsdf_by_scatterings(beta: float, sigma: float, B: float, C: float, wavelength: float) -> mpf:
    """(B/lambda)^2 exp(-g) sum_n a^n/n! F_n(b), F_n the transform of rho^n, a polynomial times exp(-n u).

    Int u^(k+1) exp(-n u) J0(b u) du = (k+1)! P_(k+1)(n/w)/w^(k+2), w^2 = n^2 + b^2, b = B beta/lambda.
    """
    with mpmath.workdps(60):
        K = 4 * mpmath.pi / mpf(wavelength)
        a = (K * mpf(sigma)) ** 2
        b = mpf(B) * mpf(beta) / mpf(wavelength)
        scale = (mpf(B) / mpf(wavelength)) ** 2
        beyond = a * (1 + scale) ** ((1 - mpf(C)) / 2)
        single = _polynomial(C)
        total, weight, power, n = mpf(0), mpf(1), [mpf(1)], 0
        while n <= a or weight > mpf(10) ** -30 * total:
            n += 1
            weight *= a / n
            power = _product(power, single)
            total += weight * _transform(power, n, b)
        return scale * mpmath.exp(beyond - a) * total / (2 * mpmath.pi)


def _product(p: list[mpf], q: list[mpf]) -> list[mpf]:
    return [
        mpmath.fsum(p[i] * q[k - i] for i in range(max(0, k - len(q) + 1), min(k + 1, len(p))))
        for k in range(len(p) + len(q) - 1)
    ]


def _transform(polynomial: list[mpf], n: int, b: mpf) -> mpf:
    w = mpmath.hypot(n, b)
    x = n / w
    total, before, legendre, factor = mpf(0), mpf(1), x, 1 / w**2
    for k, coefficient in enumerate(polynomial):
        total += coefficient * factor * legendre
        before, legendre = legendre, ((2 * k + 3) * x * legendre - (k + 1) * before) / (k + 2)
        factor *= (k + 2) / w
    return total
