"""Rays that light the pupil evenly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.telescope.system import Pupil

Real = NDArray[np.float64]

FAN = 16
"""Rays that share an azimuth of the pupil: they come in whole fans, so that none of its parts has more than others."""


def fans(pupil: Pupil, of_area: Real, of_azimuth: Real) -> tuple[Real, Real]:
    """Relative radii, shape (FAN, fans), and azimuths [rad] of fans, from numbers in [0, 1) for each fan.

    A fan has a ray in every FAN-th part of the pupil's area.
    """
    inner = pupil.obscuration**2
    start, stop = pupil.sector
    rho = np.sqrt(inner + (1.0 - inner) / FAN * (np.arange(FAN)[:, None] + of_area))
    return rho, start + (stop - start) * of_azimuth
