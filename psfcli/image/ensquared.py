"""Ensquared energy: fractions of all light in squares about a point of the image [mm]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.image.expansion import normal_probability
from psfcli.image.rectangle import Rectangles, scattered_in_rectangles
from psfcli.image.result import EnsquaredEnergy, Spot
from psfcli.image.scatter import Halo
from psfcli.image.unscattered import unscattered_in_boxes
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]


def default_half_widths(pixel: float, pixels: int) -> Real:
    """Half widths [mm]: ten per decade from 0.01 to 1000 pixels, and every whole-pixel box up to the window, increasing."""
    decades = 10.0 ** np.linspace(-2.0, 3.0, 51)
    whole = 0.5 * np.arange(1, pixels + 1)
    return pixel * np.unique(np.round(np.concatenate([decades, whole]), 12))


def unaberrated_energy(halo: Halo, half_width: Real) -> Real:
    """Ensquared energy without aberrations, the specular point included: shape of ``half_width``."""
    box = half_width[:, None] / np.sqrt(halo.mixture.variance)
    energy: Real = halo.specular_fraction + normal_probability(-box, box) ** 2 @ halo.mixture.weight
    return energy


def box_centres(spot: Spot) -> tuple[tuple[float, float], ...]:
    """The Gaussian image point, the chief ray and the centroid: what boxes are centred on."""
    return (0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)


def ensquared_energy(
    telescope: Telescope, field: Field, halo: Halo, spot: Spot, half_width: Real, tolerance: Tolerance
) -> tuple[EnsquaredEnergy, float]:
    """Energies in squares of increasing ``half_width`` about each of the ``box_centres``, within ``tolerance.ee``;

    and the estimated error of the unscattered light in them, as a fraction of all light.
    """
    distinct = list(dict.fromkeys(box_centres(spot)))
    boxes = [Rectangles.squares(centre, half_width) for centre in distinct]
    together = Rectangles(
        *(
            np.concatenate([getattr(box, edge) for box in boxes])
            for edge in ("x_start", "x_stop", "y_start", "y_stop")
        )
    )
    scattered = scattered_in_rectangles(
        telescope, field, halo.mixture, spot, together, Tolerance(pixel=1.0, ee=tolerance.ee)
    )
    energy, error = {}, 0.0
    for centre, share in zip(distinct, np.split(scattered, len(distinct)), strict=True):
        energy[centre] = share
        if halo.specular_fraction > 0.0:
            unscattered, its_error = unscattered_in_boxes(
                telescope, field, centre, half_width, 0.3 * tolerance.ee / halo.specular_fraction
            )
            energy[centre] = share + halo.specular_fraction * unscattered
            error = max(error, halo.specular_fraction * its_error)
    about = [energy[centre] for centre in box_centres(spot)]
    return EnsquaredEnergy(half_width, *about, unaberrated_energy(halo, half_width)), error
