"""A telescope as it is built: the surfaces light meets, one after another along the axis. Lengths in mm."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OpticalSurface:
    """A surface of revolution and the space behind it; z points along the light that enters the telescope.

    Sag z(r) = c r^2/(1 + sqrt(1 - (1 + K) c^2 r^2)) + A4 r^4 + A6 r^6 + ..., with ``curvature`` c = 1/R [1/mm] (R > 0:
    its centre lies towards +z), ``conic`` K [1] and ``aspheric`` (A4, A6, ...) [mm^-3, mm^-5, ...]. ``thickness`` [mm]
    is the z of the next surface's vertex less its own, negative after an odd number of mirrors; ``index`` the positive
    refractive index behind it, that before it for a mirror.
    """

    name: str
    curvature: float
    thickness: float
    conic: float = 0.0
    aspheric: tuple[float, ...] = ()
    index: float = 1.0
    is_mirror: bool = True


@dataclass(frozen=True, slots=True)
class Prescription:
    """The surfaces in the order light meets them, and what makes a telescope of them.

    ``stop`` is the index of the surface that limits the beam and ``stop_radius`` [mm] the height of the marginal ray
    there; the entrance pupil is its image. ``object_distance`` [mm] counts from the first vertex towards -z (infinite:
    a telescope). The last surface's thickness ends at the paraxial image; the detector lies ``image_shift`` [mm] from
    there, positive along the light.
    """

    surfaces: tuple[OpticalSurface, ...]
    stop: int
    stop_radius: float
    image_shift: float = 0.0
    object_distance: float = math.inf
    index_before: float = 1.0
