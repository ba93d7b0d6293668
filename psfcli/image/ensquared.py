"""Ensquared energy: fractions of all light in squares about a point of the image [mm]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import normal_probability
from psfcli.image.boxes import unscattered_in_boxes
from psfcli.image.geometric import GeometricalImage
from psfcli.image.result import EnsquaredEnergy, Spot
from psfcli.image.scatter import Halo
from psfcli.image.squares import JudgedSquares
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]


def default_half_widths(pixel: float, pixels: int) -> Real:
    """Half widths [mm], increasing: ten per decade from 0.01 to 1000 pixels, and every whole-pixel box."""
    decades = 10.0 ** np.linspace(-2.0, 3.0, 51)
    whole = 0.5 * np.arange(1, pixels + 1)
    return pixel * np.unique(np.round(np.concatenate([decades, whole]), 12))


def unaberrated_energy(halo: Halo, half_width: Real) -> Real:
    """Ensquared energy without aberrations, the specular point included: shape of ``half_width``."""
    box = halo.held(half_width)[:, None] / np.sqrt(halo.mixture.variance)
    energy: Real = halo.unscattered_weight + normal_probability(-box, box) ** 2 @ halo.mixture.weight
    return energy


def box_centres(spot: Spot) -> tuple[tuple[float, float], ...]:
    """The Gaussian image point, the chief ray and the centroid: what boxes are centred on."""
    return (0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)


def ensquared_energy(
    points: Sequence[GeometricalImage],
    halo: Halo,
    squares: JudgedSquares,
    tolerance: Tolerance,
    finer_tolerance: float,
) -> Iterator[tuple[EnsquaredEnergy, float, float]]:
    """Energies in the ``squares``, of the ``halo``'s mixture, about each of the ``box_centres``, for each point.

    Within ``tolerance.ee``. With each come the estimated errors of the unscattered light in any box and of the
    scattered light, which is judged by ``finer_tolerance``; both as fractions of all light.
    """
    distinct = [list(dict.fromkeys(box_centres(point.spot))) for point in points]
    half_width, weight = squares.used.half_width, halo.unscattered_weight
    if weight > 0.0:
        unscattered = unscattered_in_boxes(points, distinct, half_width, 0.5 * tolerance.ee / weight)
    else:
        unscattered = [(np.zeros((len(some), half_width.size)), 0.0) for some in distinct]
    unaberrated = np.minimum(unaberrated_energy(halo, half_width), 1.0)
    for point, some, (inside, error) in zip(points, distinct, unscattered, strict=True):
        scattered, difference = squares.energy(point, some, tolerance.ee, finer_tolerance)
        # a box that holds all may come out above 1 by the error allowed, one that holds nothing below 0
        energy = dict(zip(some, np.clip(scattered + weight * inside, 0.0, 1.0), strict=True))
        ee, chief, centroid = (energy[centre] for centre in box_centres(point.spot))
        yield EnsquaredEnergy(half_width, ee, chief, centroid, unaberrated), weight * error, difference
