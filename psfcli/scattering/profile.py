"""Profiles of a BSDF, and how far it departs from the shift invariance that Eq. 29 takes it to have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.hemisphere import HemisphereScatter, hemisphere_scatter
from psfcli.surface.incidence import IncidenceError
from psfcli.surface.mixture import MixtureError
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

RANGES = (1e-3, 1e-2, 1e-1)
"""The distances |beta - beta_0| within which the largest departure is told."""

_STEP = 0.1  # of the profile in ln |beta - beta_0|
_NEAREST = 1e-2  # the nearest direction to the specular one, in units of the longest knee's
_LAST = 8.0  # ln of how much nearer than the specular direction the last one is to the horizon


class ProfileError(Exception):
    """A profile that cannot be had; ``usage`` tells one asked for amiss from one that cannot be computed."""

    def __init__(self, message: str, *, usage: bool) -> None:
        super().__init__(message)
        self.usage = usage


@dataclass(frozen=True, slots=True)
class Profile:
    """The BSDF at one incidence, in the plane through the normal at azimuth ``plane`` [rad] from that of incidence.

    ``surfaces`` names those that scatter so. Arrays of one shape, by direction: ``theta_s`` [rad], positive on the
    side of the specular direction; ``offset``, |beta - beta_0| with the sign of the side; ``bsdf`` [1/sr];
    ``departure`` [1], BSDF/BSDF' - 1 with BSDF' that of normal incidence at the same |beta - beta_0|, nan where that
    lies beyond its horizon. beta are direction cosines times n'.
    """

    surfaces: tuple[str, ...]
    scatter: HemisphereScatter
    normal: HemisphereScatter
    plane: float
    theta_s: Real
    offset: Real
    bsdf: Real
    departure: Real

    @property
    def ars(self) -> Real:
        """Angle-resolved scatter BSDF cos(theta_s) [1/sr]."""
        return self.bsdf * np.cos(self.theta_s)

    @property
    def tis_change(self) -> float:
        """TIS less that of normal incidence [1]."""
        return self.scatter.incidence.tis - self.normal.incidence.tis

    def largest_departure(self, within: float) -> float:
        """The largest |departure| at |beta - beta_0| up to ``within``; nan where the plane comes no nearer."""
        near = np.abs(self.departure[(np.abs(self.offset) <= within) & np.isfinite(self.departure)])
        return float(near.max()) if near.size else math.nan


def profiles(
    surfaces: Sequence[Surface], wavelength: float, angles: Sequence[float], plane: float = 0.0
) -> tuple[Profile, ...]:
    """The profiles of all ``surfaces`` at each angle of incidence [rad], those that scatter alike as one.

    ``wavelength`` [mm], ``plane`` [rad]. The BSDF is that of ``hemisphere_scatter``, with its norm and its range; the
    incidence of the surfaces themselves is not used. Directions are dense about the specular one, from a hundredth of
    the longest knee's on, and at the horizon. Raises ProfileError for an incidence that the surface cannot have, and
    for spectra too steep and rough together.
    """
    alike: dict[Surface, list[str]] = {}
    for surface in surfaces:
        same = replace(surface, name="", marginal_height=0.0, reflectance=1.0, incidence=0.0)
        alike.setdefault(same, []).append(surface.name)
    every = []
    for surface, names in alike.items():
        named = replace(surface, name=" and ".join(names))
        try:
            normal, *others = hemisphere_scatter(named, wavelength, (0.0, *angles))
        except (IncidenceError, MixtureError) as problem:
            raise ProfileError(f"{named.name}: {problem}", usage=isinstance(problem, IncidenceError)) from None
        every += [_profile(tuple(names), scatter, normal, plane) for scatter in others]
    return tuple(every)


def _profile(names: tuple[str, ...], scatter: HemisphereScatter, normal: HemisphereScatter, plane: float) -> Profile:
    """Directions on both sides of the one nearest to the specular direction, dense there and at the horizon."""
    incidence, n = scatter.incidence, scatter.incidence.surface.index_after
    nearest = incidence.specular_cosine * math.cos(plane)
    aside = incidence.specular_cosine * abs(math.sin(plane))
    knees = [incidence.wavelength / term.B for term in incidence.surface.psd]
    sides = []
    for side in (-1.0, 1.0):
        length = n - side * nearest  # to the horizon
        u = np.arange(math.log(_NEAREST * min(knees, default=1.0) / length), _LAST, _STEP)[:: int(side)]
        along, rest = length / (1.0 + np.exp(-u)), length / (1.0 + np.exp(u))
        distance, cosine = np.hypot(along, aside), np.sqrt(rest * (2.0 * n - rest))
        beyond = distance >= n
        shifted = normal.at(distance, np.sqrt(np.where(beyond, n, n - distance) * (n + distance)))
        bsdf = scatter.at(distance, cosine)
        departure = np.full(bsdf.shape, np.nan)
        compared = ~beyond & (shifted > 0.0)
        departure[compared] = bsdf[compared] / shifted[compared] - 1.0
        sides.append((np.arctan2(nearest + side * along, cosine), side * distance, bsdf, departure))
    return Profile(names, scatter, normal, plane, *(np.concatenate(both) for both in zip(*sides, strict=True)))
