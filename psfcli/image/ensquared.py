"""Ensquared energy: fractions of all light in squares about a point of the image [mm]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import normal_probability
from psfcli.image.geometric import GeometricalImage
from psfcli.image.result import EnsquaredEnergy, Spot
from psfcli.image.scatter import Halo
from psfcli.image.squares import SquareResponse
from psfcli.image.unscattered import unscattered_in_boxes
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]


def default_half_widths(pixel: float, pixels: int) -> Real:
    """Half widths [mm], increasing: ten per decade from 0.01 to 1000 pixels, and every whole-pixel box."""
    decades = 10.0 ** np.linspace(-2.0, 3.0, 51)
    whole = 0.5 * np.arange(1, pixels + 1)
    return pixel * np.unique(np.round(np.concatenate([decades, whole]), 12))


def unaberrated_energy(halo: Halo, half_width: Real) -> Real:
    """Ensquared energy without aberrations, the specular point included: shape of ``half_width``."""
    box = half_width[:, None] / np.sqrt(halo.mixture.variance)
    energy: Real = halo.unscattered_weight + normal_probability(-box, box) ** 2 @ halo.mixture.weight
    return energy


def box_centres(spot: Spot) -> tuple[tuple[float, float], ...]:
    """The Gaussian image point, the chief ray and the centroid: what boxes are centred on."""
    return (0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)


def ensquared_energy(
    point: GeometricalImage, halo: Halo, squares: SquareResponse, tolerance: Tolerance
) -> tuple[EnsquaredEnergy, Real, float]:
    """Energies in the ``squares``, of the ``halo``'s mixture, about each of the ``box_centres``, within ``tolerance.ee``;

    of these the scattered light about the Gaussian image point, shape [box], and the estimated error of the
    unscattered light in any box; both as fractions of all light.
    """
    centres = box_centres(point.spot)
    distinct = list(dict.fromkeys(centres))
    half_width = squares.half_width
    shares = dict(zip(distinct, squares.energy(point, distinct, tolerance.ee), strict=True))
    energy, error = dict(shares), 0.0
    if halo.unscattered_weight > 0.0:
        unscattered, error = unscattered_in_boxes(
            point, distinct, half_width, 0.5 * tolerance.ee / halo.unscattered_weight
        )
        for centre, inside in zip(distinct, unscattered, strict=True):
            energy[centre] = shares[centre] + halo.unscattered_weight * inside
        error *= halo.unscattered_weight
    # a box that holds all may come out above 1 by the error allowed
    ee, chief, centroid = (np.minimum(energy[centre], 1.0) for centre in centres)
    unaberrated = np.minimum(unaberrated_energy(halo, half_width), 1.0)
    return EnsquaredEnergy(half_width, ee, chief, centroid, unaberrated), shares[centres[0]], error
