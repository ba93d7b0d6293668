"""Generalised Harvey-Shack scatter of one surface: phase variance, TIS, surface transfer function (Eq. 28, 29).

Lengths in mm. Only roughness of spatial frequency below 1/lambda (n'/lambda in a medium n') scatters.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.autocovariance import decorrelation
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]


def phase_per_height(surface: Surface, wavelength: float) -> float:
    """Phase [rad] that 1 mm of surface height gives: 2 pi (n' cos_s - n cos_i)/lambda, 4 pi/lambda for a mirror.

    A mirror is a surface with n' = -n. ``incidence`` multiplies the phase by cos_i (contract: g by cos^2).
    """
    step = 2.0 * surface.index_after if surface.is_mirror else surface.index_after - surface.index_before
    return 2.0 * math.pi * abs(step) * math.cos(surface.incidence) / wavelength


def horizon(surface: Surface, wavelength: float) -> float:
    """The highest spatial frequency that scatters, n'/lambda [cycles/mm]: it sends light out at 90 degrees."""
    return surface.index_after / wavelength


def relative_variance(surface: Surface, wavelength: float) -> float:
    """sigma_rel^2 [mm^2], the variance of surface height below the horizon."""
    return sum(term.band_variance(0.0, horizon(surface, wavelength)) for term in surface.psd)


def phase_variance(surface: Surface, wavelength: float) -> float:
    """G = (phase per height)^2 sigma_rel^2 [1]: the mean number of scatterings."""
    return phase_per_height(surface, wavelength) ** 2 * relative_variance(surface, wavelength)


def total_integrated_scatter(surface: Surface, wavelength: float) -> float:
    """TIS = 1 - exp(-g): the fraction of the light that is scattered."""
    return -math.expm1(-phase_variance(surface, wavelength))


def transfer_exponent(r: Real, surface: Surface, wavelength: float) -> Real:
    """K^2 C(r) - g [1] at separations ``r`` [mm], the logarithm of the transfer function before the clip; shape of r.

    Positive for r below about a wavelength, by the part of the roughness that lies above the horizon.
    """
    K2 = phase_per_height(surface, wavelength) ** 2
    beyond = K2 * sum(term.band_variance(horizon(surface, wavelength), math.inf) for term in surface.psd)
    exponent = np.full(np.shape(r), beyond)
    for term in surface.psd:
        exponent -= K2 * term.sigma**2 * decorrelation(2.0 * math.pi * r / term.B, (term.C - 1.0) / 2.0)
    return exponent


def surface_transfer_function(r: Real, surface: Surface, wavelength: float) -> Real:
    """H(r) = exp{-max(0, g - K^2 C(r))} [1] at separations ``r`` [mm], shape of r; H(0) = 1, H(inf) = exp(-g)."""
    return np.exp(np.minimum(0.0, transfer_exponent(r, surface, wavelength)))
