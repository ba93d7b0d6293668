"""The scattering function of one surface about the specular direction (Eq. 29)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.harvey_shack import phase_per_height, phase_variance
from psfcli.surface.mixture import GaussianMixture, ScatterTerm, mixing_density, trapezoid_step
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

_ERROR = 1e-10


def bsdf(beta: Real, surface: Surface, wavelength: float) -> Real:
    """S(beta) [1/sr], the incoherent part of Eq. 29 with Q = 1, at distances ``beta`` > 0 from the specular direction.

    S = F(beta/lambda)/lambda^2, F the two-dimensional transform of H - exp(-g); ``beta`` in direction cosines (times
    n'), shape of beta; ``wavelength`` [mm]. The specular beam, of weight exp(-g), is left out. Relative accuracy 1e-9
    for C up to 8, at any dynamic range; without the clip at the horizon, so valid for beta << 1: the clip takes a
    share that grows like beta^(C+1). Raises MixtureError for spectra both steep and rough.
    """
    K = phase_per_height(surface, wavelength)
    terms = [ScatterTerm((K * psd.sigma) ** 2, 1.0 / psd.B, (psd.C - 1.0) / 2.0) for psd in surface.psd]
    frequency = np.asarray(beta, dtype=np.float64) / wavelength
    if not terms:
        return np.zeros_like(frequency)
    g = phase_variance(surface, wavelength)
    step = trapezoid_step(_ERROR, max(term.nu for term in terms), g)
    low = min(0.5 * term.width**2 / (term.nu + 60.0) for term in terms)
    widest = max(float(frequency.max()), *(term.width for term in terms))
    high = widest**2 * _ERROR ** (-1.0 / (1.0 + min(term.nu for term in terms)))
    variance = np.exp(np.arange(math.log(low), math.log(high), step))
    density, _ = mixing_density(variance, terms, g)
    return GaussianMixture(step * density, variance).density(frequency) / wavelength**2
