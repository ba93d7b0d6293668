"""Generalised Harvey-Shack scatter into the whole hemisphere, at any incidence (Krywonos, Harvey & Choi 2011).

With alpha the direction cosines times n', alpha_0 the specular ones, and K(theta_i, theta_s) the phase per height,

    BSDF = n'^2 R F(|alpha - alpha_0|/lambda; K^2)/lambda^2,    ARS = BSDF cos(theta_s),

F the transform of exp[-K^2 sigma_rel^2 + K^2 C(r)] - exp(-K^2 sigma_rel^2), taken anew at each theta_s, and R(theta_i)
the factor that makes the integral over the hemisphere TIS = 1 - exp(-g). H is not clipped at 1, as it is for images:
what lies beyond the hemisphere is left out and made good by R, F is positive everywhere, and the limit of smooth
surfaces is their spectrum, up to the horizon.

BSDF is radiance over irradiance, ARS the share of the light per solid angle, both in 1/sr. The reflectance Q is 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.family import TransformFamily, transform_family
from psfcli.surface.incidence import Incidence
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

_STEP = 0.25  # of the trapezoid rule in the logarithm of the radius; a knee leaves exp(-pi^2/step) of itself
_LOG_ERROR = 30.0  # -ln of the light beyond the ends of that rule


@dataclass(frozen=True, slots=True)
class HemisphereScatter:
    """The scatter of a surface at one incidence, built by ``hemisphere_scatter``.

    ``renormalisation`` is R [1]; ``family`` None stands for a surface that does not scatter.
    """

    incidence: Incidence
    family: TransformFamily | None
    sigma_rel: float
    renormalisation: float = 1.0

    def bsdf(self, theta_s: Real, phi_s: Real) -> Real:
        """BSDF [1/sr] without the specular beam, ``theta_s`` [rad] from the normal, in the half plane ``phi_s`` [rad].

        theta_s lies between -pi/2 and pi/2, and phi_s = 0 contains the specular direction; arrays of any shapes that
        go together, whose shape comes back. Relative error 1e-8, however faint; positive
        wherever K is not 0.
        """
        theta_s, phi_s = np.asarray(theta_s, np.float64), np.asarray(phi_s, np.float64)
        n, theta_0 = self.incidence.surface.index_after, self.incidence.specular_angle
        # (sin theta_s - sin theta_0)^2 + 4 sin theta_s sin theta_0 sin^2(phi_s/2): no digits lost near the specular
        along = 2.0 * np.cos(0.5 * (theta_s + theta_0)) * np.sin(0.5 * (theta_s - theta_0))
        across = 4.0 * np.sin(theta_s) * math.sin(theta_0) * np.sin(0.5 * phi_s) ** 2
        return self.at(n * np.sqrt(np.maximum(along**2 + across, 0.0)), n * np.cos(theta_s))

    def ars(self, theta_s: Real, phi_s: Real) -> Real:
        """Angle-resolved scatter [1/sr], BSDF cos(theta_s): the share of the light per solid angle; as ``bsdf``."""
        return self.bsdf(theta_s, phi_s) * np.cos(theta_s)

    def at(self, distance: Real, normal: Real) -> Real:
        """BSDF [1/sr] at ``distance`` |alpha - alpha_0| where alpha has the ``normal`` component n' cos(theta_s).

        Arrays of any shapes that go together; as ``bsdf``.
        """
        distance, normal = np.broadcast_arrays(np.asarray(distance, np.float64), np.asarray(normal, np.float64))
        if self.family is None:
            return np.zeros_like(distance)
        wavelength, n = self.incidence.wavelength, self.incidence.surface.index_after
        K = self.incidence.phase_per_height(normal)
        F = self.family.transform(distance / wavelength, K, self.sigma_rel)
        return F * (self.renormalisation * (n / wavelength) ** 2)

    def total(self) -> float:
        """The integral of ARS over the hemisphere [1], but for the specular beam; relative error 1e-10.

        In polar coordinates about the specular direction, the radius being edge/[1 + exp(-u)]: its logarithm near the
        beam, that of the distance to the horizon at the other end, where cos(theta_s) goes like a square root.
        """
        peak = float(self.at(np.zeros(1), np.array([self.incidence.specular_normal]))[0])
        if peak == 0.0:
            return 0.0
        share = 0.0
        for edge, opposite, weight in zip(*self.incidence.edges(), strict=True):
            # the beam's own neighbourhood, of 1e-13 of the light
            begin = 0.5 * math.log(math.exp(-_LOG_ERROR) * self.incidence.tis / peak) - math.log(edge)
            u = np.arange(begin, _LOG_ERROR, _STEP)
            radius, rest = edge / (1.0 + np.exp(-u)), edge / (1.0 + np.exp(u))
            bsdf = self.at(radius, np.sqrt(rest * (radius - opposite)))
            share += weight * float(bsdf @ (radius**2 * rest)) * (2.0 * math.pi * _STEP / edge)
        return share / self.incidence.surface.index_after**2


def hemisphere_scatter(surface: Surface, wavelength: float, angles: Sequence[float]) -> tuple[HemisphereScatter, ...]:
    """The scatter of ``surface`` at each angle of incidence [rad]; ``surface.incidence`` is not looked at.

    ``wavelength`` [mm]. Raises IncidenceError beyond 89 degrees and where all light is reflected inside, MixtureError
    for spectra both steep and rough.
    """
    every = [Incidence(surface, wavelength, angle) for angle in angles]
    if not surface.psd:
        return tuple(HemisphereScatter(incidence, None, 0.0) for incidence in every)
    K = np.array([incidence.phase_per_height(np.array([0.0, surface.index_after])) for incidence in every])
    lowest = 0.0 if K.min() < 0.0 < K.max() else np.abs(K).min()
    highest = 2.0 * surface.index_after / wavelength
    family = transform_family(surface, wavelength, (float(lowest), float(np.abs(K).max())), highest)
    return tuple(_renormalised(incidence, family) for incidence in every)


def _renormalised(incidence: Incidence, family: TransformFamily) -> HemisphereScatter:
    plain = HemisphereScatter(incidence, family, incidence.sigma_rel)
    return replace(plain, renormalisation=incidence.tis / plain.total())
