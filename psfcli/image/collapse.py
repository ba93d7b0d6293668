"""Surfaces so near the image that their scatter is a point: the limit h2 -> 0 of Eq. 37 [mm]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.harvey_shack import horizon, phase_per_height, total_integrated_scatter
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope

Real = NDArray[np.float64]

_SHARE_OF_REACH = 2e-4
_DECADES, _RADII = 12, 400  # below d_j, where light is looked for


def is_collapsed(distance: float, reach: float) -> bool:
    """Whether a surface of magnified ``distance`` d_j is a point as seen from ``reach`` [mm].

    All of its scatter lands within d_j, and the ripples of its clip at the horizon reach farther than any fit.
    """
    return distance < _SHARE_OF_REACH * reach


@dataclass(frozen=True, slots=True)
class Collapse:
    """The scatter of one surface joined to the unscattered light.

    ``count`` is the mean number of scatterings by more than each ``radius`` [mm] in the image, ``tis`` all it scatters.
    """

    radius: Real
    count: Real
    tis: float

    def error(self, length: float) -> float:
        """The light, of all, that this moves across the edges of cells or squares of size ``length`` [mm].

        Light displaced by R crosses an edge with the chance min(1, R/length) where the spot is even. Its mean over a
        number of scatterings is at most Int_0^length count(R) dR/length, here by steps that are never too low.
        """
        radius = np.minimum(self.radius, length)
        moved = self.count[0] * radius[0] + float(self.count[:-1] @ np.diff(radius))
        return min(moved / length, self.tis)


def collapse(surface: Surface, telescope: Telescope, wavelength: float) -> Collapse:
    """What joining the scatter of ``surface`` at ``wavelength`` [mm] to the unscattered light takes."""
    distance, edge = telescope.magnified_distance(surface.marginal_height), horizon(surface, wavelength)
    share = np.geomspace(10.0**-_DECADES, 1.0, _RADII)  # of d_j, and of the horizon
    K2 = phase_per_height(surface, wavelength) ** 2
    beyond = [sum(term.band_variance(s * edge, edge) for term in surface.psd) if s < 1.0 else 0.0 for s in share]
    count = K2 * np.array(beyond)
    return Collapse(distance * share, count, total_integrated_scatter(surface, wavelength))
