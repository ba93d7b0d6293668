"""Scattered light as a sum of Gaussians, with weights read off the transfer function itself.

Every K-correlation covariance is a Gaussian mixture in r, so the unclipped transfer function, as a function of
z = 2 pi^2 q^2, is a Laplace transform

    h(q) = exp(-G + sum_i a_i rho_i) - exp(-G) = Int c(v) exp(-z v) d ln v,   c(v) >= 0,

and its two-dimensional Fourier transform is S(r) = Int c(v) exp(-r^2/2v)/(2 pi v) d ln v. The inverse transform, taken
along the ray z = tau exp(i phi), pi/2 < phi <= pi, that is along q turned by phi/2, is

    c(v) = (1/pi) Im Int  w exp(w) h d ln tau,   w = tau v exp(i phi),

a trapezoid sum in ln tau that converges exponentially. Two rays are enough. On phi = 2 pi/3 both factors decay, which
serves the core; on phi = pi (q imaginary) only Im h counts, which is known to full relative accuracy however faint
(rho = Y_nu + i J_nu), and serves the wing. Where both hold they agree to rounding, and there the switch is made.
No fit, no grid in r, no subtraction: the weights are positive by nature and the trapezoid rule in ln v is the only
approximation, with relative error 2 |Gamma(p + i omega)/Gamma(p)|, omega = 2 pi/step, p = (C + 1)/2, at every radius.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.surface.autocovariance import autocovariance_off_axis, autocovariance_on_cut

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CORE_ANGLE = 2.0 * math.pi / 3.0
_LARGEST_VARIANCE = 1000.0
_LOG_HUGE = 600.0  # on the cut h may grow without bound, far beyond where exp(-w) lets it count
_LOG_MIN = math.log(1e-17)  # w below which a constant h has nothing left to say


@dataclass(frozen=True, slots=True)
class ScatterTerm:
    """One PSD term as the image sees it.

    ``phase_variance`` a = (K sigma)^2 [1] over all frequencies, ``width`` w such that u = 2 pi w q at image-plane
    frequency q (w = lambda d_j/B [mm]), ``nu`` = (C - 1)/2.
    """

    phase_variance: float
    width: float
    nu: float


@dataclass(frozen=True, slots=True)
class GaussianMixture:
    """sum_k weight_k N(r; variance_k): a radial density in the plane, N = exp(-r^2/2v)/(2 pi v) [1/mm^2]."""

    weight: Real
    variance: Real

    def only(self, some: NDArray[np.bool_]) -> GaussianMixture:
        """The terms that ``some`` marks."""
        return GaussianMixture(self.weight[some], self.variance[some])

    def density(self, r: Real) -> Real:
        """The density [1/mm^2] at distances ``r`` [mm], shape of r."""
        x = np.asarray(r, dtype=np.float64)[..., None] ** 2 / (2.0 * self.variance)
        return np.exp(-x) @ (self.weight / (2.0 * math.pi * self.variance))


def trapezoid_error(step: float, nu: float, total_variance: float) -> float:
    """Relative error of the mixture with grid ``step`` in ln v, for terms of order ``nu`` and mean count G [1].

    One-fold light has v = w^2/2t, t gamma-distributed of order nu, and its density the Mellin transform
    Gamma(p + i omega)/Gamma(p) with p = nu + 1 at the first alias omega = 2 pi/step; n-fold light, a sum of n such v,
    is no narrower in ln v than order n nu. Averaged over Poisson(n; G).
    """
    return _trapezoid_error(step, *_mellin_orders(nu, total_variance))


def _mellin_orders(nu: float, total_variance: float) -> tuple[Real, Real]:
    """The orders p of the light scattered n times, and how often that is."""
    spread = 10.0 + 10.0 * math.sqrt(total_variance)
    n = np.unique(np.linspace(max(1.0, total_variance - spread), total_variance + spread, 200).astype(int))
    log_poisson = n * math.log(total_variance) - special.gammaln(n + 1.0)
    poisson = np.exp(log_poisson - log_poisson.max())
    return n * nu + 1.0, poisson / poisson.sum()


def _trapezoid_error(step: float, p: Real, poisson: Real) -> float:
    omega = 2.0 * math.pi / step
    return float(2.0 * np.exp(special.loggamma(p + 1j * omega).real - special.gammaln(p)) @ poisson)


def trapezoid_step(error: float, nu: float, total_variance: float) -> float:
    """The widest grid step in ln v whose ``trapezoid_error`` stays below ``error``."""
    orders = _mellin_orders(nu, total_variance)
    low, high = 1e-3, 4.0
    for _ in range(24):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if _trapezoid_error(middle, *orders) < error else (low, middle)
    return low


class MixtureError(ArithmeticError):
    """A scatter whose mixing density the two rays do not resolve: very large C, or g of many thousands."""


def mixing_density(
    v: Real, terms: Sequence[ScatterTerm], total_variance: float, error: float = 1e-24
) -> tuple[Real, float]:
    """c(v) [per unit of ln v] at increasing variances ``v`` [mm^2], same shape, and its relative error at the switch.

    ``total_variance`` is G; ``error`` is what the trapezoid rule along the rays may leave, exp(-2 pi (pi/6)/step) on
    the core ray, of the largest term: in the valley between a narrow and a wide one the density is many decades below
    both, and the core of what is steep and rough is a small difference. The error that comes back is rounding up to
    C = 6, some 1e-12 at C = 8, 1e-7 at C = 12, and grows with C and G. Raises MixtureError where the density is not
    finite or holds more light than is scattered: it is then a difference of huge numbers.
    """
    highest = max(term.nu for term in terms)
    fault = MixtureError(
        f"scatter with C = {1.0 + 2.0 * highest:.6g} and a total phase variance of {total_variance:.4g} is beyond "
        f"what the mixture of Gaussians resolves (C to 10 at 1, 7 at 30, 3 at 300; nothing above {_LARGEST_VARIANCE:g})"
    )
    if total_variance > _LARGEST_VARIANCE:
        raise fault
    with np.errstate(all="ignore"):
        step = math.pi**2 / 3.0 / math.log(100.0 / error)
        core = _on_core_ray(v, terms, total_variance, step)
        wing = _on_cut(v, terms, total_variance, step)
        disagreement = np.abs(core / wing - 1.0)
    switch = int(np.argmin(np.where(np.isfinite(disagreement), disagreement, np.inf)))
    density = np.maximum(np.where(np.arange(v.size) < switch, core, wing), 0.0)
    beyond = sum(term.phase_variance for term in terms) - total_variance
    light = math.expm1(min(beyond, _LOG_HUGE)) - math.expm1(-total_variance)
    if not np.trapezoid(density, np.log(v)) < 1.1 * light:
        raise fault
    return density, float(disagreement[switch]) if np.isfinite(disagreement[switch]) else 1.0


def _ray(v: Real, log_end: float, step: float) -> Real:
    return np.exp(np.arange(_LOG_MIN - math.log(v[-1]), log_end - math.log(v[0]), step))


def _on_core_ray(v: Real, terms: Sequence[ScatterTerm], total_variance: float, step: float) -> Real:
    turn = complex(math.cos(_CORE_ANGLE), math.sin(_CORE_ANGLE))
    tau = _ray(v, math.log(40.0 / -turn.real), step)
    q = np.sqrt(tau * turn / (2.0 * math.pi**2))
    exponent = np.zeros(tau.shape, dtype=np.complex128)
    for term in terms:
        exponent += term.phase_variance * autocovariance_off_axis(2.0 * math.pi * term.width * q, term.nu)
    h = _scattered_share(exponent, total_variance)
    w = np.multiply.outer(v, tau * turn)
    return (np.exp(w) * w).dot(h).imag * (step / math.pi)


def _scattered_share(exponent: Complex, total_variance: float) -> Complex:
    """exp(-G) [exp(x) - 1], neither losing digits for small x nor overflowing for large G."""
    bounded = np.where(exponent.real < _LOG_HUGE + total_variance, exponent, 0.0)
    share: Complex
    if total_variance < 1.0:
        share = (math.exp(-total_variance) * np.expm1(bounded)).astype(np.complex128)
    else:
        share = (np.exp(bounded - total_variance) - math.exp(-total_variance)).astype(np.complex128)
    return share


def _on_cut(v: Real, terms: Sequence[ScatterTerm], total_variance: float, step: float) -> Real:
    tau = _ray(v, math.log(60.0), step)
    t = np.sqrt(tau / (2.0 * math.pi**2))
    real = np.full(tau.shape, -total_variance)
    imaginary = np.zeros(tau.shape)
    for term in terms:
        re, im = autocovariance_on_cut(2.0 * math.pi * term.width * t, term.nu)
        real += term.phase_variance * re
        imaginary += term.phase_variance * im
    h = np.exp(np.minimum(real, _LOG_HUGE)) * np.sin(imaginary)
    w = np.multiply.outer(v, tau)
    return (w * np.exp(-w)).dot(-h) * (step / math.pi)
