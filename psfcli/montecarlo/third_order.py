"""Rays of third-order geometry (Eq. 4) that scatter: the landing points whose distribution Eq. 44 states [mm]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.montecarlo.pupil import FAN, fans
from psfcli.montecarlo.sequence import QuasiRandom
from psfcli.montecarlo.spectrum import Scatterer, directions, poisson_tail, repeatedly, scatterers
from psfcli.surface.surface import Surface
from psfcli.telescope.aberration import transverse_aberration_along_azimuths
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

_AT_ONCE = 1 << 14  # rays whose arrays stay in the cache


@dataclass(frozen=True, slots=True)
class ThirdOrderRays:
    """Rays of one ``field`` at one ``wavelength`` [mm]: landing = eps(pupil, field) + sum_j lambda d_j (sum of f)."""

    telescope: Telescope
    surfaces: Sequence[Surface]
    wavelength: float
    field: Field

    def landings(self, generator: np.random.Generator, count: int) -> Iterator[tuple[Real, Real]]:
        """Landing points (x, y) [mm] about the Gaussian image point of ``count`` rays, a multiple of FAN, in blocks.

        The pupil point, how often each term of each spectrum scatters, and its first |f| are quasi-random with one
        shift for all rays; all else is by chance.
        """
        terms = self._terms()
        numbers = QuasiRandom.drawn(generator, 2 + 2 * len(terms))
        for first in range(0, count, _AT_ONCE):
            here = min(_AT_ONCE, count - first) // FAN
            x, y = self._unscattered(*numbers.points(slice(2), first // FAN, here))
            how = numbers.points(slice(2, None), first, x.size)
            for (scatterer, scale, tail), often, nearest in zip(terms, how[::2], how[1::2], strict=True):
                for n, ray in enumerate(repeatedly(tail, often)):
                    f = scatterer.frequencies(generator, ray.size) if n else scatterer.frequencies_at(nearest[ray])
                    f *= scale
                    along_x, along_y = directions(generator, ray.size)
                    x[ray] += f * along_x
                    y[ray] += f * along_y
            yield x, y

    def _terms(self) -> list[tuple[Scatterer, float, Real]]:
        """Each term that scatters, lambda d_j [mm^2] of its surface, and how probable n or more scatterings are."""
        return [
            (
                scatterer,
                self.wavelength * self.telescope.magnified_distance(surface.marginal_height),
                poisson_tail(scatterer.mean),
            )
            for surface in self.surfaces
            for scatterer in scatterers(surface, self.wavelength)
        ]

    def _unscattered(self, of_area: Real, of_azimuth: Real) -> tuple[Real, Real]:
        """The ray errors of fans, one after another in rings of the pupil."""
        telescope = self.telescope
        rho, azimuth = fans(telescope.pupil, of_area, of_azimuth)
        x, y = (
            (((cubic[3] * rho + cubic[2]) * rho + cubic[1]) * rho + cubic[0]).ravel()
            for cubic in transverse_aberration_along_azimuths(
                telescope.seidel, telescope.relative_field(self.field), azimuth, telescope.image_slope
            )
        )
        return x, y
