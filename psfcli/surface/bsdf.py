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
    K = phase_per_height(surface, wavelength)
    terms = [ScatterTerm((K * psd.sigma) ** 2, 1.0 / psd.B, (psd.C - 1.0) / 2.0) for psd in surface.psd]
    frequency = np.asarray(beta, dtype=np.float64) / wavelength
    g = phase_variance(surface, wavelength)
    if g == 0.0:
        return np.zeros_like(frequency)
    highest = float(frequency.max(initial=0.0))
    (coarse, _), (fine, joint) = (_density(frequency, highest, terms, g, error) for error in _RAY_ERRORS)
    if joint > _PROMISE or np.any(np.abs(coarse - fine) > _PROMISE * fine):
        raise MixtureError(
            f"the scatter of {surface.name} in some of these directions is not resolved: C = "
            f"{max(psd.C for psd in surface.psd):.6g} with a phase variance of {g:.4g} is too steep and rough together"
        )
    return fine / wavelength**2


def _density(
    frequency: Real, highest: float, terms: Sequence[ScatterTerm], g: float, ray_error: float
) -> tuple[Real, float]:
    """F by Gaussians that reach beyond the ``highest`` frequency, and how far the two rays disagree where they join."""
    nu = [term.nu for term in terms]
    step = trapezoid_step(_ERROR, max(nu), g)
    low = min(0.5 * term.width**2 / (term.nu + 60.0) for term in terms)
    # the core widens like a stable law, g^(1/nu), or like facets, g, unless the single scatterings outshine it
    log_core = 2.0 * math.log(max(term.width for term in terms)) + min(g, math.log1p(g) / min(1.0, *nu))
    log_high = max(2.0 * math.log(highest), log_core) - math.log(_ERROR) / (1.0 + min(nu))
    variance = np.exp(np.arange(math.log(low), log_high, step))
    density, joint = mixing_density(variance, terms, g, ray_error)
    return GaussianMixture(step * density, variance).density(frequency), joint
