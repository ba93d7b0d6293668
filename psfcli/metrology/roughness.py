"""What follows from a fit: rms in a band, rms that scatters, TIS; each with its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.metrology.fit import Fit
from psfcli.metrology.spectrum import k_correlations
from psfcli.surface.harvey_shack import horizon, phase_per_height
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

NORMAL_95 = 1.959963984540054
"""Standard errors on either side in a 95 % interval."""
_STEP = 1e-5  # of a central difference: what is left of it, 1e-10, and rounding, 1e-9 of the gradient, are alike


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value, and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Scattering:
    """What a mirror scatters at a ``wavelength`` [mm] and normal incidence: ``sigma_rel`` [mm] and ``tis`` [1]."""

    wavelength: float
    sigma_rel: Estimate
    tis: Estimate


def band_rms(fit: Fit, f1: float, f2: float) -> Estimate:
    """The rms [mm] of the surface between spatial frequencies ``f1`` < ``f2`` [cycles/mm], as of ``sigma_band``.

    sigma^2 = sum_j sigma_j^2 {[1 + (B_j f1)^2]^((1-C_j)/2) - [1 + (B_j f2)^2]^((1-C_j)/2)}, over the plane.
    """
    return _estimate(fit, lambda terms: math.sqrt(sum(term.band_variance(f1, f2) for term in terms)))


def scattering(fit: Fit, wavelength: float) -> Scattering:
    """sigma_rel and TIS = 1 - exp(-(4 pi sigma_rel/wavelength)^2) of a mirror polished so, at normal incidence.

    TIS rises with sigma_rel, so the ends of its interval are those of sigma_rel: they stay between 0 and 1.
    """
    mirror = Surface("", 0.0)
    K = phase_per_height(mirror, wavelength)
    sigma_rel = band_rms(fit, 0.0, horizon(mirror, wavelength))
    tis = (-math.expm1(-((K * sigma) ** 2)) for sigma in (sigma_rel.value, sigma_rel.low, sigma_rel.high))
    return Scattering(wavelength, sigma_rel, Estimate(*tis))


def _estimate(fit: Fit, quantity: Callable[[Sequence[KCorrelation]], float]) -> Estimate:
    """A positive ``quantity`` of the terms; ln of it is normal, var = grad^T covariance grad (the delta method)."""

    def logarithm(parameters: Real) -> float:
        return math.log(quantity(k_correlations(parameters.reshape(fit.parameters.shape))))

    flat = fit.parameters.ravel()
    steps = _STEP * np.eye(flat.size)
    gradient = np.array([(logarithm(flat + step) - logarithm(flat - step)) / (2.0 * _STEP) for step in steps])
    error = NORMAL_95 * math.sqrt(float(gradient @ fit.covariance @ gradient))
    value = quantity(fit.spectra)
    return Estimate(value, value * math.exp(-error), value * math.exp(error))
