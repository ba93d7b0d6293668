"""The scattering function of one surface about the specular direction (Eq. 29)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.harvey_shack import phase_per_height, phase_variance
from psfcli.surface.mixture import GaussianMixture, MixtureError, ScatterTerm, mixing_density, trapezoid_step
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

_ERROR = 1e-13  # of the mixture's step in ln v; a finer one changes rounding and no more
_RAY_ERRORS = (1e-20, 1e-24)  # of the rays to the mixing density, whose smallest values are 1e-10 of what is summed
_PROMISE = 1e-8


def bsdf(beta: Real, surface: Surface, wavelength: float) -> Real:
    """S(beta) [1/sr], the incoherent part of Eq. 29 with Q = 1, at distances ``beta`` > 0 from the specular direction.

    S = F(beta/lambda)/lambda^2, F the two-dimensional transform of H - exp(-g); ``beta`` in direction cosines (times
    n'), shape of beta; ``wavelength`` [mm]. The specular beam, of weight exp(-g), is left out. Relative accuracy 1e-8,
    and 1e-12 for C up to 6 and g up to 10, at any dynamic range; without the clip at the horizon, so valid for
    beta << 1: the clip takes a share that grows like beta^(C+1). Raises MixtureError for spectra both steep and rough,
    where two calculations by different steps, or the two rays of the mixture, disagree.
    """
    frequency = np.asarray(beta, dtype=np.float64) / wavelength
    g = phase_variance(surface, wavelength)
    if g == 0.0:
        return np.zeros_like(frequency)
    terms = scatter_terms(surface, phase_per_height(surface, wavelength))
    variance, step = variances(float(frequency.max(initial=0.0)), terms, g)
    return resolved(frequency, variance, step, terms, g).density(frequency) / wavelength**2


def scatter_terms(surface: Surface, K: float) -> list[ScatterTerm]:
    """The terms of a surface in spatial frequency: widths in cycles/mm, phase variances at ``K`` [rad/mm]."""
    return [ScatterTerm((K * psd.sigma) ** 2, 1.0 / psd.B, (psd.C - 1.0) / 2.0) for psd in surface.psd]


def variances(highest: float, terms: Sequence[ScatterTerm], g: float) -> tuple[Real, float]:
    """Variances [1/mm^2] of Gaussians that reach beyond the ``highest`` frequency, and their step in ln v.

    They serve any phase variance up to ``g`` [1].
    """
    nu = [term.nu for term in terms]
    step = trapezoid_step(_ERROR, max(nu), g)
    low = min(0.5 * term.width**2 / (term.nu + 60.0) for term in terms)
    # the core widens like a stable law, g^(1/nu), or like facets, g, unless the single scatterings outshine it
    log_core = 2.0 * math.log(max(term.width for term in terms)) + min(g, math.log1p(g) / min(1.0, *nu))
    log_high = max(2.0 * math.log(highest), log_core) - math.log(_ERROR) / (1.0 + min(nu))
    return np.exp(np.arange(math.log(low), log_high, step)), step


def resolved(frequency: Real, variance: Real, step: float, terms: Sequence[ScatterTerm], g: float) -> GaussianMixture:
    """F as a mixture, which calculations by different steps give alike at each ``frequency``; MixtureError if not.

    F [mm^2] is the two-dimensional transform of H - exp(-g).
    """
    (coarse, _), (fine, joint) = (mixing_density(variance, terms, g, error) for error in _RAY_ERRORS)
    mixture = GaussianMixture(step * fine, variance)
    expected = mixture.density(frequency)
    apart = np.abs(GaussianMixture(step * coarse, variance).density(frequency) - expected)
    if joint > _PROMISE or np.any(apart > _PROMISE * expected):
        steepest = 1.0 + 2.0 * max(term.nu for term in terms)
        raise MixtureError(
            f"the scatter in some of these directions is not resolved: C = {steepest:.6g} "
            f"with a phase variance of {g:.4g} is too steep and rough together"
        )
    return mixture
