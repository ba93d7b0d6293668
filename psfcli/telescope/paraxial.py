"""First-order optics of a prescription: the marginal and the chief ray, pupils, focal length. Lengths in mm.

Heights y and slopes u = dy/dz along the axis; n is the refractive index, negative while light travels towards -z, so
that one rule serves lenses and mirrors (W. T. Welford, Aberrations of Optical Systems, chapter 3):

    refraction n' u' = n u - y c (n' - n),  transfer y' = y + u' t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from psfcli.telescope.prescription import Prescription


class ParaxialError(ValueError):
    """A prescription without a real image, or whose stop limits nothing; the message says which."""


@dataclass(frozen=True, slots=True)
class ParaxialRay:
    """``heights`` [mm] at the surfaces, and ``slopes`` [1] in the spaces before, between and behind them."""

    heights: tuple[float, ...]
    slopes: tuple[float, ...]

    def plus(self, factor: float, other: ParaxialRay) -> ParaxialRay:
        """The sum of this ray and ``factor`` times another: paraxial rays are linear."""
        return ParaxialRay(
            tuple(y + factor * z for y, z in zip(self.heights, other.heights, strict=True)),
            tuple(u + factor * v for u, v in zip(self.slopes, other.slopes, strict=True)),
        )


@dataclass(frozen=True, slots=True)
class ParaxialTrace:
    """The marginal and the chief ray of a prescription, of which all first-order quantities are made.

    ``indices`` n [1] of the spaces before, between and behind the surfaces, negative where light travels towards -z.
    The marginal ray starts upwards, the chief ray from below the axis (object at infinity: its slope is the tangent
    of the field angle): their image orientation is that of W131 and W311 in Eq. 2.
    """

    prescription: Prescription
    indices: tuple[float, ...]
    marginal: ParaxialRay
    chief: ParaxialRay

    @property
    def lagrange_invariant(self) -> float:
        """The product n (u ybar - ubar y) [mm], the same in every space; never positive here."""
        y, ybar = self.marginal.heights[0], self.chief.heights[0]
        return self.indices[0] * (self.marginal.slopes[0] * ybar - self.chief.slopes[0] * y)

    @property
    def image_slope(self) -> float:
        """The slope u' of Eq. 4 [1]: the image space's index times the marginal ray's slope there, as a magnitude."""
        return abs(self.indices[-1] * self.marginal.slopes[-1])

    @property
    def image_distance(self) -> float:
        """The z of the paraxial image less that of the last vertex [mm]."""
        return -self.marginal.heights[-1] / self.marginal.slopes[-1]

    @property
    def image_height(self) -> float:
        """Distance of the paraxial image of the field's edge from the axis [mm]."""
        return abs(self.lagrange_invariant) / self.image_slope

    @property
    def power(self) -> float:
        """1/(focal length) [1/mm]: phi = -n' u'/y of a ray that comes in parallel to the axis."""
        parallel = _ray(self.prescription, self.indices, 1.0, 0.0)
        return -self.indices[-1] * parallel.slopes[-1]

    @property
    def entrance_pupil(self) -> tuple[float, float]:
        """The z from the first vertex (infinite: telecentric) and radius [mm] of the stop's image in object space."""
        z = _crossing(self.chief.heights[0], self.chief.slopes[0])
        return z, _height(self.marginal.heights[0], self.marginal.slopes[0], z)

    @property
    def exit_pupil(self) -> tuple[float, float]:
        """The z from the last vertex (infinite: telecentric) and radius [mm] of the stop's image in image space."""
        z = _crossing(self.chief.heights[-1], self.chief.slopes[-1])
        return z, _height(self.marginal.heights[-1], self.marginal.slopes[-1], z)

    @property
    def incidences(self) -> tuple[tuple[float, float], ...]:
        """Of each surface the angles of incidence i = u + y c of the marginal and the chief ray [rad, paraxial]."""
        return tuple(
            (u + y * s.curvature, ubar + ybar * s.curvature)
            for s, y, u, ybar, ubar in zip(
                self.prescription.surfaces,
                self.marginal.heights,
                self.marginal.slopes[:-1],
                self.chief.heights,
                self.chief.slopes[:-1],
                strict=True,
            )
        )


def signed_indices(prescription: Prescription) -> tuple[float, ...]:
    """The n of the spaces before, between and behind the surfaces [1], its sign that of the light's way along z."""
    indices = [prescription.index_before]
    for surface in prescription.surfaces:
        indices.append(-indices[-1] if surface.is_mirror else math.copysign(surface.index, indices[-1]))
    return tuple(indices)


def trace(prescription: Prescription, max_field: float) -> ParaxialTrace:
    """The marginal ray through the rim of the stop and the chief ray of the field's edge through its centre.

    ``max_field`` is an angle [rad] for an object at infinity, else the object height [mm]. Raises ParaxialError where
    light leaves the last surface parallel or meets no image behind it, or the stop lies in an image.
    """
    indices = signed_indices(prescription)
    distance = prescription.object_distance
    if math.isinf(distance):
        axial = _ray(prescription, indices, 1.0, 0.0)
        oblique = _ray(prescription, indices, 0.0, math.tan(max_field))
    else:
        axial = _ray(prescription, indices, 1.0, 1.0 / distance)
        oblique = _ray(prescription, indices, 0.0, max_field / distance)
    at_stop = axial.heights[prescription.stop]
    if abs(at_stop) < 1e-9 * max(map(abs, axial.heights)):
        raise ParaxialError("the stop lies in an image of the object, where it limits nothing")
    scale = prescription.stop_radius / abs(at_stop)
    nothing = ParaxialRay(tuple(0.0 for _ in axial.heights), tuple(0.0 for _ in axial.slopes))
    found = ParaxialTrace(
        prescription,
        indices,
        marginal=nothing.plus(scale, axial),
        chief=oblique.plus(-oblique.heights[prescription.stop] / at_stop, axial),
    )
    _require_real_image(found, axial)
    return found


def focused(prescription: Prescription, entrance_pupil_radius: float, detector: float | None = None) -> Prescription:
    """The prescription with its stop sized to an entrance pupil [mm] and its last thickness at the paraxial image.

    ``detector`` [mm], z from the last vertex, replaces ``image_shift``. Raises ParaxialError as ``trace`` does, and
    where the entrance pupil is at infinity while the object is not.
    """
    found = trace(prescription, 1.0)
    _, radius = found.entrance_pupil
    if not math.isfinite(radius):
        raise ParaxialError("the entrance pupil lies at infinity, and has no aperture_diameter")
    last = replace(prescription.surfaces[-1], thickness=found.image_distance)
    shift = prescription.image_shift
    if detector is not None:
        shift = math.copysign(1.0, found.indices[-1]) * (detector - found.image_distance)
    return replace(
        prescription,
        surfaces=(*prescription.surfaces[:-1], last),
        stop_radius=prescription.stop_radius * entrance_pupil_radius / radius,
        image_shift=shift,
    )


def _ray(prescription: Prescription, indices: tuple[float, ...], y: float, u: float) -> ParaxialRay:
    """The ray that meets the first vertex plane at height ``y`` with slope ``u``."""
    heights, slopes = [], [u]
    for surface, n, n_behind in zip(prescription.surfaces, indices, indices[1:], strict=False):
        heights.append(y)
        u = (n * u - y * surface.curvature * (n_behind - n)) / n_behind
        slopes.append(u)
        y += u * surface.thickness
    return ParaxialRay(tuple(heights), tuple(slopes))


def _require_real_image(found: ParaxialTrace, axial: ParaxialRay) -> None:
    """Raises ParaxialError unless light converges behind the last surface."""
    steepest = max(abs(u) for u in axial.slopes)
    if abs(axial.slopes[-1]) <= 1e-12 * steepest:
        raise ParaxialError("light leaves the last surface parallel: there is no image")
    along_light = math.copysign(1.0, found.indices[-1]) * found.image_distance
    if not along_light > 0.0:
        raise ParaxialError(
            f"the image is virtual: it lies {-along_light:.6g} mm before the last surface, as light travels"
        )


def _crossing(y: float, u: float) -> float:
    """The z at which a ray of height ``y`` and slope ``u`` at z = 0 meets the axis; infinite where it never does."""
    return -y / u if u else math.inf


def _height(y: float, u: float, z: float) -> float:
    """The height of a ray at ``z``, as a magnitude; that of a ray parallel to the axis also at infinity."""
    return abs(y + u * z) if u else abs(y)
