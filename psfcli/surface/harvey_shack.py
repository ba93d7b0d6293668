"""Generalised Harvey-Shack scatter of one surface: phase variance, TIS, surface transfer function (Eq. 28, 29).

Lengths in mm. Only roughness of spatial frequency below 1/lambda (n'/lambda in a medium n') scatters.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.autocovariance import both_parts
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


def relative_rms(surface: Surface, wavelength: float) -> float:
    """sigma_rel [mm], the rms of surface height below the horizon."""
    edge = horizon(surface, wavelength)
    return math.hypot(*(term.sigma * math.sqrt(term.band_share(0.0, edge)) for term in surface.psd))


def phase_variance(surface: Surface, wavelength: float) -> float:
    """G = (phase per height)^2 sigma_rel^2 [1]: the mean number of scatterings."""
    return (phase_per_height(surface, wavelength) * relative_rms(surface, wavelength)) ** 2


def phase_variance_beyond(surface: Surface, wavelength: float) -> float:
    """The phase variance b [1] of the roughness above the horizon, which does not scatter.

    The transfer function before the clip holds e^b of the light.
    """
    edge = horizon(surface, wavelength)
    return phase_per_height(surface, wavelength) ** 2 * sum(t.band_variance(edge, math.inf) for t in surface.psd)


def total_integrated_scatter(surface: Surface, wavelength: float) -> float:
    """TIS = 1 - exp(-g): the fraction of the light that is scattered."""
    return -math.expm1(-phase_variance(surface, wavelength))


def transfer_exponent(r: Real, surface: Surface, wavelength: float) -> Real:
    """K^2 C(r) - g [1] at separations ``r`` [mm], the logarithm of the transfer function before the clip; shape of r.

    Positive for r below about a wavelength, by the part of the roughness that lies above the horizon. A term of phase
    variance a = (K sigma)^2, of which the share s lies beyond the horizon, adds a s - a (1 - rho) = a rho - a (1 - s):
    that of the two is taken whose rho or 1 - rho is the smaller.
    """
    K, edge = phase_per_height(surface, wavelength), horizon(surface, wavelength)
    exponent = np.zeros(np.shape(r))
    for term in surface.psd:
        a = (K * term.sigma) ** 2
        rho, decorrelation = both_parts(2.0 * math.pi * np.asarray(r) / term.B, (term.C - 1.0) / 2.0)
        near = a * term.band_share(edge, math.inf) - a * decorrelation
        far = a * rho - a * term.band_share(0.0, edge)
        exponent += np.where(decorrelation < 0.5, near, far)
    return exponent


def surface_transfer_function(r: Real, surface: Surface, wavelength: float) -> Real:
    """H(r) = exp{-max(0, g - K^2 C(r))} [1] at separations ``r`` [mm], shape of r; H(0) = 1, H(inf) = exp(-g).

    Relative error below 1e-12 max(1, -ln H) for C - 1 from 2e-6 to 2000 and g up to 1e6; next to the clip, where K^2 C
    and g cancel, 1e-14 (K sigma)^2 more, which counts for surfaces of g above 100. 0 below the normal doubles.
    """
    transfer = np.exp(np.minimum(0.0, transfer_exponent(r, surface, wavelength)))
    return np.where(transfer < np.finfo(np.float64).tiny, 0.0, transfer)
