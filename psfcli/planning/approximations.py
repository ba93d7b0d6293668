"""Measures of the model's approximations: what diffraction, aberrations, figure and incidence would change."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.harvey_shack import horizon, phase_variance, relative_rms
from psfcli.surface.surface import Surface
from psfcli.telescope.aberration import aberration_gradient
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

_RADII, _AZIMUTHS = 17, 256
_FIRST_ZERO = 3.8317059702075125  # of J1


def airy_diameter(wavelength: float, image_slope: float) -> float:
    """Diameter of the first dark ring [mm] of an unobscured pupil: 1.22 lambda/u', 2.44 lambda f/D."""
    return _FIRST_ZERO / math.pi * wavelength / image_slope


def kappa(telescope: Telescope, field: Field, image_height: float) -> float:
    """The largest |d eps/d x_image| [1] over the lit pupil; ``image_height`` [mm] is that of max_field.

    Light that a surface scatters goes on as if it came from another field, so that it lands off by this share of its
    distance from the image point, which Eq. 42 neglects. To 1e-4 of itself; for surfaces before aberrations arise.
    """
    rho = np.linspace(telescope.pupil.obscuration, 1.0, _RADII)[:, None]
    azimuth = np.linspace(*telescope.pupil.sector, _AZIMUTHS + 1)
    gradient = aberration_gradient(
        telescope.seidel,
        telescope.relative_field(field),
        rho * np.cos(azimuth),
        rho * np.sin(azimuth),
        telescope.image_slope,
    )
    (a, b), (c, d) = gradient
    # the larger singular value of a matrix of two rows
    norm = 0.5 * (np.hypot(a + d, c - b) + np.hypot(a - d, b + c))
    return float(norm.max()) / image_height


def scattered_twice(g: float) -> float:
    """P(n >= 2) = 1 - exp(-g)(1 + g) [1] of the Poisson number of scatterings, without cancellation.

    (1 - exp(-g)) - g exp(-g); for small g its series, g^2/2 - g^3/3.
    """
    return g * g * (0.5 - g / 3.0 + g * g / 8.0) if g < 1e-4 else -math.expm1(-g) - g * math.exp(-g)


def figure_share(surface: Surface, wavelength: float) -> float:
    """The share [1] of sigma_rel^2 at spatial frequencies below 1/D, D = 2 |h_j| the diameter of the beam there."""
    edge = horizon(surface, wavelength)
    beam = 2.0 * abs(surface.marginal_height)
    lowest = min(1.0 / beam, edge) if beam else edge
    # of rms, not of variances, which underflow
    figure = math.hypot(*(term.sigma * math.sqrt(term.band_share(0.0, lowest)) for term in surface.psd))
    return (figure / relative_rms(surface, wavelength)) ** 2


def tis_changes(surface: Surface, wavelength: float, incidence: Real) -> Real:
    """How much |TIS| of light at angles of ``incidence`` [rad] differs from the one modelled; shape of ``incidence``.

    g goes with (n' cos_s - n cos_i)^2 in the specular direction: for a mirror with cos^2 of incidence.
    """
    before, behind = surface.index_before, surface.index_after
    cos = np.cos(incidence)
    if surface.is_mirror:
        step = cos
    else:
        refracted = np.sqrt(np.maximum(1.0 - (before / behind * np.sin(incidence)) ** 2, 0.0))
        step = (behind * refracted - before * cos) / (behind - before) if behind != before else cos
    modelled = phase_variance(surface, wavelength)
    g = modelled * (step / math.cos(surface.incidence)) ** 2
    return np.abs(np.exp(-g) - math.exp(-modelled))
