"""What the recipe hands to the products: the image of one field point, and each surface's share of the scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.tolerance import Tolerance

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spot:
    """The geometrical spot about the Gaussian image point [mm]; rms about the centroid.

    ``x_min`` to ``y_max`` bound everything that unscattered light touches.
    """

    centroid_x: float
    centroid_y: float
    chief_x: float
    chief_y: float
    rms_x: float
    rms_y: float
    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclass(frozen=True, slots=True)
class EnsquaredEnergy:
    """Fractions of all light in squares of ``half_width`` [mm], each array of shape [box].

    About the Gaussian image point (``ee``), the chief ray, the centroid of the spot, and without aberrations.
    """

    half_width: Array
    ee: Array
    ee_chief: Array
    ee_centroid: Array
    ee_unaberrated: Array


@dataclass(frozen=True, slots=True)
class FieldImage:
    """The image of one field point at one wavelength.

    ``psf`` [y, x] is the fraction of all light in each pixel, ``psf_over`` the same on sub-pixels (None when
    oversample is 1); ``power_outside`` the fraction that misses the window, by its own route; all three are None when
    no cube was asked for. ``reached`` are the estimated errors.
    """

    psf: Array | None
    psf_over: Array | None
    spot: Spot
    ensquared: EnsquaredEnergy
    power_outside: float | None
    reached: Tolerance


@dataclass(frozen=True, slots=True)
class SurfaceScatter:
    """One surface at one wavelength: name, ``wavelength`` [mm], ``sigma_rel`` [mm] (rms below the horizon),

    ``g`` = (phase rms)^2, ``tis`` = 1 - exp(-g), ``magnified_distance`` d_j [mm], ``reflectance``.
    """

    name: str
    wavelength: float
    sigma_rel: float
    g: float
    tis: float
    magnified_distance: float
    reflectance: float
