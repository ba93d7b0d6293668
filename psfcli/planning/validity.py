"""How far the model can be trusted on a scene, as numbers: its approximations, each with what it may at most be.

Geometrical optics (Section 1 of the paper), figure that is not scatter, the transfer function, shift invariance, the
small angles of Eq. 36, Eq. 42, and what the model leaves out: rays that miss a surface. None of it is among the errors
of a run, which are errors against the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import spot_moments
from psfcli.image.grid import Detector
from psfcli.planning.approximations import airy_diameter, figure_share, kappa, scattered_twice, tis_changes
from psfcli.planning.geometry import incidences, vignetting
from psfcli.surface.harvey_shack import horizon, phase_variance
from psfcli.surface.surface import Surface
from psfcli.telescope.paraxial import ParaxialTrace, trace
from psfcli.telescope.prescription import Prescription
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

DIFFRACTION = 0.25
"""Airy diameter over pixel or spot above which the geometrical image misleads."""
FIGURE = 0.01
"""Share of the roughness with periods beyond the beam above which part of it is figure."""
SHORTEST_KNEE = 0.1
"""Wavelength over B above which the transfer function no longer holds."""
INCIDENCE = 0.01
"""Change of TIS by incidence, in fractions of the light, above which scatter is not shift invariant."""
EQ_42 = 0.05
"""Displacement of scattered rays by aberrations, over their distance from the image point."""
SMALL_ANGLE = 0.3
"""Sine of a scattering angle above which it is not small."""

_MOST_SPOTS, _MOST_EQ_42 = 64, 16  # fields looked at
_ANGLES = np.radians(np.arange(0.0, 89.05, 0.1))


@dataclass(frozen=True, slots=True)
class Criterion:
    """A measure of an approximation, ``ok`` up to ``threshold`` (inf: whatever it is), and a sentence of ``advice``.

    ``value`` [1, unless ``name`` says a unit] is the worst over wavelengths and fields; nan: it cannot be known.
    """

    name: str
    value: float
    threshold: float
    advice: str

    @property
    def ok(self) -> bool:
        """Whether the value is not known to exceed the threshold."""
        return not self.value > self.threshold

    @property
    def warning(self) -> str:
        """What is told of one that is not ok, in one line."""
        return f"{self.name} is {self.value:.2g}, more than {self.threshold:g}: {self.advice}"

    def report(self) -> dict[str, object]:
        """The criterion as JSON holds it: no number stands where there is none."""
        numbers = {"value": self.value, "threshold": self.threshold}
        return {
            "criterion": self.name,
            **{name: number for name, number in numbers.items() if math.isfinite(number)},
            "ok": self.ok,
            "advice": self.advice,
        }


def validity(
    telescope: Telescope,
    surfaces: Sequence[Surface],
    wavelengths: Sequence[float],
    fields: Sequence[Field],
    detector: Detector,
    reach: float,
    prescription: Prescription | None = None,
) -> tuple[Criterion, ...]:
    """The criteria of a scene whose pixels and squares lie within ``reach`` [mm] of the image point.

    What only a ``prescription`` tells is nan without it.
    """
    rays = None if prescription is None else trace(prescription, telescope.max_field)
    rough = [surface for surface in surfaces if surface.psd]
    return (
        *_diffraction(telescope, wavelengths, fields, detector),
        _eq_42(telescope, fields, rays),
        *(_figure(surface, wavelengths) for surface in rough),
        *(_knee(surface, wavelengths) for surface in rough),
        *(_shift_invariance(surface, wavelengths, telescope, fields, rays) for surface in rough),
        *(_small_angle(surface, telescope, reach) for surface in rough),
        *_missed(surfaces, telescope, reach, rays),
        *(_multiple_scatter(surface, wavelengths) for surface in rough),
        *_band_used(rough, telescope, wavelengths, detector.pixel, reach),
    )


def _diffraction(
    telescope: Telescope, wavelengths: Sequence[float], fields: Sequence[Field], detector: Detector
) -> Iterator[Criterion]:
    airy = airy_diameter(max(wavelengths), telescope.image_slope)
    _, rms = spot_moments(telescope, _spread(telescope, fields, _MOST_SPOTS))
    smallest = 2.0 * float(np.hypot(*rms.T).min())
    yield Criterion(
        "Airy diameter / pixel",
        airy / detector.pixel,
        DIFFRACTION,
        f"diffraction, {1e3 * airy:.3g} um wide, is not modelled; a larger share of a pixel needs wave optics",
    )
    yield Criterion(
        "Airy diameter / spot",
        airy / smallest if smallest else math.inf,
        DIFFRACTION,
        f"the smallest spot is {1e3 * smallest:.3g} um wide (twice its rms); trust what is much wider than "
        f"{1e3 * airy:.3g} um",
    )


def _eq_42(telescope: Telescope, fields: Sequence[Field], rays: ParaxialTrace | None) -> Criterion:
    height = math.nan
    if telescope.focal_length is not None:
        height = telescope.focal_length * math.tan(telescope.max_field)
    elif rays is not None:
        height = rays.image_height
    value = max(kappa(telescope, field, height) for field in _spread(telescope, fields, _MOST_EQ_42))
    advice = "scattered light lands off by that share of its distance from the image point, by aberrations of Eq. 42"
    if math.isnan(height):
        advice = "at finite conjugates the image height, and so the error of Eq. 42, is known of a prescription alone"
    return Criterion("kappa of Eq. 42", value, EQ_42, advice)


def _figure(surface: Surface, wavelengths: Sequence[float]) -> Criterion:
    beam = 2.0 * abs(surface.marginal_height)
    return Criterion(
        f"figure in psd of {surface.name}",
        max(figure_share(surface, wavelength) for wavelength in wavelengths),
        FIGURE,
        f"roughness of periods beyond the {beam:.4g} mm of the beam is figure: it belongs into the Seidel table",
    )


def _knee(surface: Surface, wavelengths: Sequence[float]) -> Criterion:
    return Criterion(
        f"wavelength / B of {surface.name}",
        1.0 / min(horizon(surface, wavelength) * term.B for term in surface.psd for wavelength in wavelengths),
        SHORTEST_KNEE,
        "the surface transfer function holds for correlation lengths B of ten wavelengths or more",
    )


def _shift_invariance(
    surface: Surface,
    wavelengths: Sequence[float],
    telescope: Telescope,
    fields: Sequence[Field],
    rays: ParaxialTrace | None,
) -> Criterion:
    change = _worst(lambda wavelength: tis_changes(surface, wavelength, _ANGLES), wavelengths)
    met = None if rays is None else incidences(rays, surface.name, telescope, fields)
    if met is None:
        beyond = _ANGLES[change > INCIDENCE]
        advice = "incidence is known of a prescription alone; " + (
            f"from {math.degrees(beyond[0]):.1f} deg on TIS would be off by {INCIDENCE:g}"
            if beyond.size
            else "whatever it is, TIS is hardly off"
        )
        return Criterion(f"TIS off by incidence, {surface.name}", math.nan, INCIDENCE, advice)
    ends = np.array(met)
    value = float(_worst(lambda wavelength: tis_changes(surface, wavelength, ends), wavelengths).max())
    least, most = (math.degrees(angle) for angle in met)
    advice = f"incidence is {least:.2g} to {most:.2g} deg; the surface's key incidence takes a mean one into account"
    return Criterion(f"TIS off by incidence, {surface.name}", value, INCIDENCE, advice)


def _small_angle(surface: Surface, telescope: Telescope, reach: float) -> Criterion:
    d = surface.index_after * telescope.magnified_distance(surface.marginal_height)
    return Criterion(
        f"sine of scattering at {surface.name}",
        reach / d if d else math.inf,
        SMALL_ANGLE,
        f"{reach:.4g} mm from the image point; beyond {SMALL_ANGLE * d:.4g} mm light was scattered by more than 17 "
        "degrees, outside the small angles of Eq. 36",
    )


def _missed(
    surfaces: Sequence[Surface], telescope: Telescope, reach: float, rays: ParaxialTrace | None
) -> Iterator[Criterion]:
    if rays is None:
        if any(surface.psd for surface in surfaces[:-1]):
            advice = "from where on scattered rays miss the next surface is known of a prescription alone"
            yield Criterion("distance / vignetting", math.nan, 1.0, advice)
        return
    for surface in surfaces:
        found = vignetting(rays, surface.name, telescope.pupil.obscuration)
        if not surface.psd or found is None:
            continue
        distance = surface.index_after * telescope.magnified_distance(surface.marginal_height) * found.angle
        yield Criterion(
            f"distance / vignetting at {surface.name}",
            reach / distance if distance else math.inf,
            1.0,
            f"less light arrives from {distance:.4g} mm on: scattered by {math.degrees(found.angle):.2g} deg, rays "
            f"begin to miss {found.next_surface}",
        )


def _multiple_scatter(surface: Surface, wavelengths: Sequence[float]) -> Criterion:
    g = max(phase_variance(surface, wavelength) for wavelength in wavelengths)
    advice = "light scattered there twice or more, which Eq. 29 includes; first-order theory would lack it"
    return Criterion(f"multiple scatter at {surface.name}", scattered_twice(g), math.inf, advice)


def _band_used(
    rough: Sequence[Surface], telescope: Telescope, wavelengths: Sequence[float], pixel: float, reach: float
) -> Iterator[Criterion]:
    for surface in rough:
        d = telescope.magnified_distance(surface.marginal_height)
        where = ((pixel, max(wavelengths), "from", "a pixel"), (reach, min(wavelengths), "to", f"{reach:.4g} mm"))
        for x, wavelength, end, place in where:
            edge = horizon(surface, wavelength)
            f = min(x / (wavelength * d), edge) if d else edge
            advice = f"f = x/(lambda d) at {place} from the image point; a fit extrapolates where nobody measured"
            yield Criterion(f"psd of {surface.name} used {end} [1/mm]", f, math.inf, advice)


def _worst(of: Callable[[float], Real], wavelengths: Sequence[float]) -> Real:
    return np.max([of(wavelength) for wavelength in wavelengths], axis=0)


def _spread(telescope: Telescope, fields: Sequence[Field], most: int) -> list[Field]:
    """At most ``most`` of the fields, evenly spread by distance from the axis, nearest and farthest among them."""
    ordered = sorted(fields, key=lambda field: math.hypot(*telescope.relative_field(field)))
    places = np.linspace(0, len(ordered) - 1, min(len(ordered), most)).round().astype(int)
    return [ordered[place] for place in places]
