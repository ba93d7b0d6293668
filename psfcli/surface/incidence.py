"""Light on a surface at any angle of incidence: phase, roughness that scatters, TIS.

Directions are direction cosines times the refractive index n' of the space the light is scattered into: the specular
one is alpha_0 = (n sin(theta_i), 0), and spatial frequencies f scatter into alpha_0 + lambda f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

STEEPEST = math.radians(89.0)
"""The largest angle of incidence [rad]."""

_LOG_ERROR = 40.0  # -ln of what the trapezoid rule in azimuth leaves


class IncidenceError(ValueError):
    """An angle of incidence beyond ``STEEPEST``, or one at which all light is reflected."""


@dataclass(frozen=True, slots=True)
class Incidence:
    """Light of a ``wavelength`` [mm] that meets ``surface`` at ``angle`` [rad] from its normal, 0 to ``STEEPEST``.

    ``surface.incidence`` is not looked at. Raises IncidenceError.
    """

    surface: Surface
    wavelength: float
    angle: float

    def __post_init__(self) -> None:
        """Refuse an angle at which there is no specular direction."""
        if not 0.0 <= self.angle <= STEEPEST:
            raise IncidenceError(
                f"an angle of incidence of {math.degrees(self.angle):.6g} deg is out of range; allowed: 0 deg..89 deg"
            )
        if self.specular_cosine >= self.surface.index_after:
            critical = math.degrees(math.asin(self.surface.index_after / self.surface.index_before))
            raise IncidenceError(
                f"at {math.degrees(self.angle):.6g} deg all light is reflected; allowed: below {critical:.6g} deg"
            )

    @property
    def specular_cosine(self) -> float:
        """|alpha_0| = n sin(theta_i) [1]."""
        return self.surface.index_before * math.sin(self.angle)

    @property
    def specular_angle(self) -> float:
        """The angle [rad] of the specular direction from the normal: of refraction, or of incidence for a mirror."""
        return math.asin(self.specular_cosine / self.surface.index_after)

    def phase_per_height(self, normal: Real) -> Real:
        """K [rad/mm] towards directions of ``normal`` component n' cos(theta_s), shape of normal; with its sign.

        2 pi (n' cos_s - n cos_i)/lambda; a mirror is a surface with n cos_i of the other sign.
        """
        before = self.surface.index_before * math.cos(self.angle)
        step: Real = normal + before if self.surface.is_mirror else normal - before
        return 2.0 * math.pi * step / self.wavelength

    @property
    def specular_normal(self) -> float:
        """The normal component of the specular direction, n' cos(theta_0) [1]."""
        return self.surface.index_after * math.cos(self.specular_angle)

    def edges(self) -> tuple[Real, Real, Real]:
        """The edge of the hemisphere in polar coordinates about the specular direction.

        The distances |alpha - alpha_0| to it at azimuths between 0 and pi; those in the opposite directions, negative;
        and the weight of each azimuth in a mean over all. The trapezoid rule over the period converges like
        exp(-2 azimuths arcosh(n'/|alpha_0|)).
        """
        n, centre = self.surface.index_after, self.specular_cosine
        intervals = 1 + math.ceil(_LOG_ERROR / (2.0 * math.acosh(n / centre))) if centre > 0.0 else 1
        psi = np.linspace(0.0, math.pi, intervals + 1)
        chord = np.sqrt(n * n - (centre * np.sin(psi)) ** 2)
        weight = np.full(intervals + 1, 1.0 / intervals)
        weight[[0, -1]] *= 0.5
        return chord - centre * np.cos(psi), -chord - centre * np.cos(psi), weight

    @property
    def sigma_rel(self) -> float:
        """The rms [mm] of the roughness that scatters into the hemisphere: |f + alpha_0/lambda| < n'/lambda."""
        edge, _, weight = self.edges()
        variance = [
            w * term.band_variance(0.0, float(radius) / self.wavelength)
            for term in self.surface.psd
            for radius, w in zip(edge, weight, strict=True)
        ]
        return math.sqrt(math.fsum(variance))

    @property
    def g(self) -> float:
        """K^2 sigma_rel^2 [1] with the K of the specular direction: the mean number of scatterings."""
        return float(self.phase_per_height(np.array(self.specular_normal)) * self.sigma_rel) ** 2

    @property
    def tis(self) -> float:
        """TIS = 1 - exp(-g) [1]."""
        return -math.expm1(-self.g)
