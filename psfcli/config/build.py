"""The frozen models of a system, from checked values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from psfcli.config.model import System
from psfcli.config.prescribed import finished_surfaces, traced
from psfcli.config.units import Pixels
from psfcli.image.grid import Detector
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.paraxial import ParaxialTrace
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.seidel_sums import system_table
from psfcli.telescope.system import Field, Pupil, Telescope
from psfcli.tolerance import PRESETS, Tolerance

Values = Mapping[str, Any]


def build(values: Values, text: str, warnings: tuple[str, ...]) -> System:
    """The system the checked and faultless ``values`` describe."""
    accuracy = values["accuracy"]
    boxes = values.get("ensquared_energy")
    surfaces = values["surfaces"]
    trace = traced(values["prescription"], values["telescope"]) if "prescription" in values else None
    listed = finished_surfaces(surfaces, trace) if trace else zip(surfaces, indices(surfaces), strict=True)
    return System(
        title=values.get("title", ""),
        wavelengths=tuple(values["wavelengths"]),
        telescope=_prescribed(values["telescope"], trace) if trace else _telescope(values["telescope"], surfaces),
        surfaces=tuple(_surface(surface, f"surface_{i}", media) for i, (surface, media) in enumerate(listed, start=1)),
        fields=tuple(field for field in field_points(values) if field),
        detector=_detector(values["detector"]),
        half_widths=tuple(boxes["half_widths"]) if boxes else None,
        tolerance=Tolerance(**accuracy) if isinstance(accuracy, dict) else PRESETS[accuracy],
        text=text,
        warnings=warnings,
        prescription=trace.prescription if trace else None,
    )


def indices(surfaces: list[Values | None]) -> list[tuple[float | None, float | None]]:
    """The refractive indices before and after each surface; None where a bad value leaves them unknown.

    A mirror inherits the medium it sits in; the first medium is vacuum unless the first surface says otherwise.
    """
    media: list[tuple[float | None, float | None]] = []
    medium: float | None = 1.0
    for surface in surfaces:
        before, after = medium, medium
        if surface is None or ("index" not in surface and surface.get("kind") != "mirror"):
            after = None
        elif "index" in surface:
            before, after = surface["index"] if len(surface["index"]) == 2 else (None, None)
        media.append((before, after))
        medium = after
    return media


def spectrum(term: Values) -> KCorrelation:
    """The K-correlation a checked term stands for, whichever convention it is given in.

    Raises ArithmeticError where the numbers leave no finite spectrum.
    """
    B = term["B"]
    match term["convention"]:
        case "scatmech":
            return KCorrelation.from_S0(term["A"], B, term["C"] - 1.0)
        case "zemax":
            return KCorrelation.from_band_rms(term["sigma"], 0.0, 1.0 / term["sigma_wavelength"], B, term["s"] - 1.0)
    if "A" in term:
        return KCorrelation.from_A(term["A"], B, term["C"])
    if "S0" in term:
        return KCorrelation.from_S0(term["S0"], B, term["C"])
    if "sigma_band" in term:
        f1, f2 = term["sigma_band"]
        return KCorrelation.from_band_rms(term["sigma"], f1, f2, B, term["C"])
    return KCorrelation(term["sigma"], B, term["C"])


def field_points(values: Values) -> list[Field | None]:
    """The field points in the order given; None for a bad one, nothing for a bad range."""
    given = values.get("fields", [])
    if isinstance(given, float):
        given = [given]
    elif isinstance(given, dict):
        if not given.keys() >= {"start", "stop", "count"}:
            return []
        start, stop, steps = given["start"], given["stop"], given["count"] - 1
        given = [(start * (steps - i) + stop * i) / steps for i in range(steps + 1)]
    return [_field(point) for point in given]


def _field(point: float | Values | None) -> Field | None:
    if isinstance(point, float):
        return Field(point)
    if point is None or not point.keys() >= {"radius", "azimuth"}:
        return None
    return Field(point["radius"], point["azimuth"])


def _telescope(telescope: Values, surfaces: list[Values]) -> Telescope:
    own = telescope.get("seidel", {})
    tables = [own, *(surface["seidel"] for surface in surfaces if "seidel" in surface)]
    if "focal_length" in telescope:
        slope = telescope["aperture_diameter"] / (2.0 * telescope["focal_length"])
    else:
        last = indices(list(surfaces))[-1][1] if surfaces else 1.0
        slope = (last or 1.0) * telescope["exit_pupil_radius"] / telescope["image_distance"]
    return Telescope(
        image_slope=slope,
        pupil=_pupil(telescope),
        seidel=SeidelTable.total(_seidel(table, own.get("reference_wavelength", 0.0)) for table in tables),
        max_field=telescope["max_field"],
        focal_length=telescope.get("focal_length"),
    )


def _prescribed(telescope: Values, trace: ParaxialTrace) -> Telescope:
    """The telescope that third-order optics sees in a prescription."""
    at_infinity = math.isinf(trace.prescription.object_distance)
    return Telescope(
        image_slope=trace.image_slope,
        pupil=_pupil(telescope),
        seidel=system_table(trace),
        max_field=telescope["max_field"],
        focal_length=telescope["aperture_diameter"] / (2.0 * trace.image_slope) if at_infinity else None,
    )


def _pupil(telescope: Values) -> Pupil:
    start, stop = telescope.get("sector", (0.0, 2.0 * math.pi))
    return Pupil(telescope["obscuration"], (start, stop))


def _seidel(table: Values, reference: float) -> SeidelTable:
    """The coefficients in mm; ``reference`` [mm] holds unless the table has its own wavelength."""
    wave = table.get("reference_wavelength", reference)
    return SeidelTable(**{name: waves * wave for name, waves in table.items() if name != "reference_wavelength"})


def _surface(surface: Values, default_name: str, media: tuple[float | None, float | None]) -> Surface:
    before, after = media
    assert before is not None
    assert after is not None
    terms = (spectrum(term) for term in surface.get("psd", []))
    return Surface(
        name=surface.get("name", default_name),
        marginal_height=surface["marginal_height"],
        psd=tuple(term for term in terms if term.sigma > 0.0),
        reflectance=surface["reflectance"],
        incidence=surface["incidence"],
        is_mirror=surface["kind"] == "mirror",
        index_before=before,
        index_after=after,
    )


def _detector(detector: Values) -> Detector:
    pixel = detector["pixel"]
    dx, dy = (float(s * pixel if isinstance(s, Pixels) else s) for s in detector.get("offset", (0.0, 0.0)))
    return Detector(pixel, detector["pixels"], detector["oversample"], detector["centre"], (dx, dy))
