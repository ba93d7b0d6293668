"""Exact rays through the surfaces of a prescription, scattered at each at its real angles [mm]."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.montecarlo.family import RelativeMean, scattered
from psfcli.montecarlo.optics import normal, paraxial_matrix, to_plane, to_surface
from psfcli.montecarlo.pupil import FAN, fans
from psfcli.montecarlo.sequence import QuasiRandom
from psfcli.montecarlo.spectrum import scatterers
from psfcli.surface.surface import Surface
from psfcli.telescope.prescription import OpticalSurface, Prescription
from psfcli.telescope.system import Field, Pupil

Real = NDArray[np.float64]

_AT_ONCE = 1 << 13  # rays whose arrays stay in the cache
_CLEAR = 1.05  # clear radius of a surface, relative to what the unscattered rays of max_field need
_PUPIL_FANS = 1 << 10  # for centroids and clear radii


@dataclass(frozen=True, slots=True)
class ExactRays:
    """Rays of one ``field`` [rad] of an object at infinity, at one ``wavelength`` [mm].

    ``surfaces`` are those of the ``prescription``, in the same order; their ``incidence`` is not used. A surface loses
    rays beyond its ``clear`` radius [mm] (``clear_radii``). Scatter has the two-parameter family at mirrors (Krywonos,
    Harvey & Choi 2011, as in ``family``); at refracting surfaces the mean number is that of the specular ray, whatever
    theta_s. Valid where geometrical optics is; light scatters on in the direction of the specular ray's hemisphere, and
    meets every surface once.
    """

    prescription: Prescription
    surfaces: Sequence[Surface]
    pupil: Pupil
    wavelength: float
    field: Field
    clear: tuple[float, ...]

    def landings(self, generator: np.random.Generator, count: int) -> Iterator[tuple[Real, Real]]:
        """Landing points (x, y) [mm] about the Gaussian image point, of ``count`` rays, a multiple of FAN, in blocks.

        Rays that miss a surface or its clear aperture are lost: they lie at infinity, in no square. The pupil point and
        how often each surface scatters a ray are quasi-random with one shift for all rays; all else is by chance.
        """
        numbers = QuasiRandom.drawn(generator, 2 + len(self.surfaces))
        for first in range(0, count, _AT_ONCE):
            here = min(_AT_ONCE, count - first) // FAN
            rho, azimuth = fans(self.pupil, *numbers.points(slice(2), first // FAN, here))
            often = numbers.points(slice(2, None), first, FAN * here)
            pupil = (rho * np.cos(azimuth)).ravel(), (rho * np.sin(azimuth)).ravel()
            *_, landed = self._path(*pupil, (generator, often))
            yield self._about_gaussian(np.where(np.isfinite(landed[:2]).all(axis=0), landed[:2], np.inf))

    def unscattered(self, pupil_x: Real, pupil_y: Real) -> tuple[Real, Real]:
        """Landing points (x, y) [mm] about the Gaussian image point of rays through points of the unit pupil."""
        *_, landed = self._path(pupil_x, pupil_y)
        return self._about_gaussian(landed)

    def centres(self) -> tuple[tuple[float, float], ...]:
        """Gaussian image point, chief ray and centroid of the unscattered rays, about the first of them [mm]."""
        x, y = self.unscattered(*_even_pupil(self.pupil))
        chief_x, chief_y = self.unscattered(np.zeros(1), np.zeros(1))
        return (0.0, 0.0), (float(chief_x[0]), float(chief_y[0])), (float(x.mean()), float(y.mean()))

    def heights(self) -> Real:
        """The largest distance from the axis of unscattered rays at each surface [mm]."""
        *met, _ = self._path(*_even_pupil(self.pupil))
        return np.array([np.hypot(point[0], point[1]).max() for point in met])

    def _about_gaussian(self, landed: Real) -> tuple[Real, Real]:
        """Points (x, y) about where the paraxial chief ray meets the detector: f tan(theta), but for its shift."""
        height = chief_height(self.prescription) * math.tan(self.field.radius)
        along_x, along_y = self._along_field()
        return landed[0] - height * along_x, landed[1] - height * along_y

    def _along_field(self) -> tuple[float, float]:
        return math.sin(0.5 * math.pi - self.field.azimuth), math.sin(self.field.azimuth)

    def _path(
        self, pupil_x: Real, pupil_y: Real, scatter: tuple[np.random.Generator, Real] | None = None
    ) -> Iterator[Real]:
        """Points (3, rays) on each surface and on the detector, in its frame; nan where a ray is lost.

        ``scatter``: chance, and a number in [0, 1) for each surface and ray; nothing is lost at clear radii without.
        """
        radius, z = entrance_pupil(self.prescription)
        along_x, along_y = self._along_field()
        across = math.sin(self.field.radius)
        point = np.stack([radius * pupil_x, radius * pupil_y, np.full(pupil_x.size, z)])
        direction = np.array([[across * along_x], [across * along_y], [math.cos(self.field.radius)]])
        direction = np.repeat(direction, pupil_x.size, axis=1)
        index, sense = self.prescription.index_before, 1.0
        for i, (optical, rough) in enumerate(zip(self.prescription.surfaces, self.surfaces, strict=True)):
            point = to_surface(optical, point, direction)
            if scatter:
                point[:, np.hypot(point[0], point[1]) > self.clear[i]] = np.nan
            yield point
            by_chance = (scatter[0], scatter[1][i]) if scatter else None
            direction = self._after(optical, rough, index, point, direction, by_chance)
            sense = -sense if optical.is_mirror else sense
            point = np.stack([point[0], point[1], point[2] - optical.thickness])
            index = index if optical.is_mirror else optical.index
        yield to_plane(point, direction, sense * self.prescription.image_shift)

    def _after(
        self,
        optical: OpticalSurface,
        rough: Surface,
        index: float,
        point: Real,
        direction: Real,
        by_chance: tuple[np.random.Generator, Real] | None,
    ) -> Real:
        """Directions behind a surface, scattered ``by_chance``."""
        N = normal(optical, point)
        incident = np.sum(direction * N, axis=0)  # cos_i, with the sense of N
        N *= np.sign(incident)  # along the light
        after = index if optical.is_mirror else optical.index
        along = direction - np.abs(incident) * N
        along *= index / after
        if by_chance:
            t1 = np.stack([N[2], np.zeros_like(incident), -N[0]]) / np.hypot(N[0], N[2])
            t2 = np.cross(N, t1, axis=0)
            specular = np.sum(along * t1, axis=0), np.sum(along * t2, axis=0)
            largest, relative_mean = _phase(optical, index, np.abs(incident), specular)
            terms = scatterers(rough, self.wavelength, largest)
            beta_x, beta_y = scattered(terms, *by_chance, specular, self.wavelength / after, relative_mean)
            along = beta_x * t1 + beta_y * t2
        cosine = np.sqrt(1.0 - np.sum(along**2, axis=0))
        return along + (-cosine if optical.is_mirror else cosine) * N


def clear_radii(
    prescription: Prescription, surfaces: Sequence[Surface], pupil: Pupil, max_field: float
) -> tuple[float, ...]:
    """Radii [mm] that hold all unscattered rays of fields up to ``max_field`` [rad] in any direction, and 5 % more.

    One for each of the ``surfaces``, in their order. A prescription does not say where its surfaces end; what the field
    needs is the least that was built.
    """
    whole = Pupil(pupil.obscuration)
    edges = [ExactRays(prescription, surfaces, whole, 1.0, Field(r), ()) for r in (0.0, max_field, -max_field)]
    return tuple(_CLEAR * float(h) for h in np.max([rays.heights() for rays in edges], axis=0))


def chief_height(prescription: Prescription) -> float:
    """Where the paraxial chief ray meets the detector, per tangent of its field angle [mm]: f, with no image shift.

    The third-order ray errors are about this point: their defocus does not move the chief ray.
    """
    behind = paraxial_matrix(prescription.surfaces, prescription.index_before)
    sense = (-1.0) ** sum(surface.is_mirror for surface in prescription.surfaces)
    distance = prescription.surfaces[-1].thickness + sense * prescription.image_shift
    _, z = entrance_pupil(prescription)
    height, slope = behind @ np.array([-z, 1.0])
    return float(height + distance * slope)


def entrance_pupil(prescription: Prescription) -> tuple[float, float]:
    """Radius, and z from the first vertex, of the paraxial image of the stop [mm], which lies in no image."""
    before = prescription.surfaces[: prescription.stop]
    matrix = np.eye(2)
    if before:
        to_stop = np.array([[1.0, before[-1].thickness], [0.0, 1.0]])
        matrix = to_stop @ paraxial_matrix(before, prescription.index_before)
    # at the stop y = a (Y + p u) + b u for a ray of height Y in a plane p before the vertex: p = -b/a, y = a Y
    return prescription.stop_radius / abs(float(matrix[0, 0])), float(matrix[0, 1] / matrix[0, 0])


def _even_pupil(pupil: Pupil) -> tuple[Real, Real]:
    """Points that light the unit pupil evenly: always the same."""
    rho, azimuth = fans(pupil, *QuasiRandom.drawn(np.random.default_rng(0), 2).points(slice(2), 0, _PUPIL_FANS))
    return (rho * np.cos(azimuth)).ravel(), (rho * np.sin(azimuth)).ravel()


def _phase(
    optical: OpticalSurface, index: float, cos_i: Real, specular: tuple[Real, Real]
) -> tuple[float, RelativeMean]:
    """The largest phase per height of any ray, relative to that at normal incidence, and the means relative to its."""
    if optical.is_mirror:
        return 1.0, lambda ray, cos_s: (0.5 * (cos_i[ray] + cos_s)) ** 2
    cos_0 = np.sqrt(1.0 - specular[0] ** 2 - specular[1] ** 2)
    phase = (optical.index * cos_0 - index * cos_i) / (optical.index - index)
    largest = float(np.nanmax(phase))
    return largest, lambda ray, _: (phase[ray] / largest) ** 2
