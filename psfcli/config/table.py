"""The table of keys of a system file: the checker, the JSON Schema and the reference are all made from it."""

from __future__ import annotations

from psfcli.config.kinds import (
    ByConjugates,
    ByPrescription,
    Either,
    Key,
    Listing,
    Number,
    Quantity,
    Section,
    Text,
    Variants,
    Word,
)
from psfcli.config.prescription_table import INDEX, PRESCRIPTION
from psfcli.config.units import ANGLE, FREQUENCY, LENGTH, LENGTH4, SHIFT, VOLUME
from psfcli.metrology.measurement import GAIN_ERROR, KINDS, MOST_TERMS
from psfcli.tolerance import PRESETS

WAVELENGTH = Quantity(LENGTH, "0.1 nm", "1 mm", "nm")
APERTURE = Quantity(LENGTH, "1 um", "1 km", "mm")
DISTANCE = Quantity(LENGTH, "1 mm", "1 km", "mm")
MARGINAL_HEIGHT = Quantity(LENGTH, "1 nm", "1 km", "mm", magnitude=True)
AZIMUTH = Quantity(ANGLE, "-360 deg", "720 deg", "deg")
FIELD = ByConjugates(Quantity(ANGLE, "-89 deg", "89 deg", "deg"), Quantity(LENGTH, "-1 km", "1 km", "mm"))
MAX_FIELD = ByConjugates(Quantity(ANGLE, "1e-6 arcsec", "89 deg", "deg"), Quantity(LENGTH, "1 nm", "1 km", "mm"))
INCIDENCE = Quantity(ANGLE, "0 deg", "10 deg", "deg", why="beyond it the halo is no longer round")
SCATTER_INCIDENCE = Quantity(ANGLE, "0 deg", "89 deg", "deg")  # options of psfcli bsdf
SCATTER_PLANE = AZIMUTH
SPATIAL_FREQUENCY = Quantity(FREQUENCY, "0 1/mm", "1e9 1/mm", "cycles/mm")
ROUGHNESS = Quantity(LENGTH, "0 nm", "100 mm", "nm")
HALF_WIDTH = Quantity(LENGTH, "1 pm", "1 km", "um")
WAVES = Number(-1e6, 1e6)
MOST_PIXELS = 16384
_PRESCRIBED = "the prescription gives it; take out one of the two"
_SHAPES = dict.fromkeys(("radius", "conic", "aspheric", "thickness"), "belongs to a surface of prescription.surfaces")

SEIDEL = Section(
    {
        "reference_wavelength": Key(WAVELENGTH, "The wavelength whose waves the coefficients count."),
        "W020": Key(WAVES, "Defocus, the same at every field; below 0 the detector lies inside focus.", default=0),
        "W040": Key(WAVES, "Spherical aberration.", default=0),
        "W131": Key(WAVES, "Coma.", default=0),
        "W222": Key(WAVES, "Astigmatism.", default=0),
        "W220": Key(WAVES, "Field curvature: Hopkins' whole coefficient of H^2 rho^2.", default=0),
        "W311": Key(WAVES, "Distortion: a shift of the image.", default=0),
    },
    name="seidel",
)

_PUPIL = {
    "obscuration": Key(Number(0, 1, below=True), "Linear central obscuration.", default=0),
    "sector": Key(Listing(AZIMUTH, 2, 2), "First and last lit azimuth of the pupil, +x towards +y; default all."),
    "max_field": Key(MAX_FIELD, "The field where the Seidel table holds (H = 1).", required=True),
}

TELESCOPE = Section(
    {
        "focal_length": Key(DISTANCE, "Focal length; the object lies at infinity."),
        "aperture_diameter": Key(APERTURE, "Full width of the entrance pupil; goes with focal_length."),
        "image_distance": Key(DISTANCE, "From the exit pupil to the Gaussian image, at finite conjugates."),
        "exit_pupil_radius": Key(APERTURE, "Goes with image_distance."),
        **_PUPIL,
        "seidel": Key(SEIDEL, "Wavefront at the pupil rim and full field."),
    },
    alternatives=(("focal_length", "aperture_diameter"), ("image_distance", "exit_pupil_radius")),
    name="telescope",
)

PRESCRIBED_TELESCOPE = Section(
    {"aperture_diameter": Key(APERTURE, "Full width of the entrance pupil.", required=True), **_PUPIL},
    name="telescope, with a prescription",
    refused=dict.fromkeys(("focal_length", "image_distance", "exit_pupil_radius", "seidel"), _PRESCRIBED),
)

_B = Key(Quantity(LENGTH, "1 nm", "1 km", "mm"), "The length of the knee: it lies at the frequency 1/B.", required=True)
_C = Key(Number(1, 1000, beyond=True), "Slope of the one-dimensional spectrum.", required=True)
_CONVENTIONS = Word(("harvey", "scatmech", "zemax", "measured"))
_CONVENTION = Key(_CONVENTIONS, "Whose parameters the term is given in.", default="harvey")
_STEEPER = Number(2, 1001, beyond=True)

PSD = Variants(
    "convention",
    "harvey",
    {
        "harvey": Section(
            {
                "convention": _CONVENTION,
                "sigma": Key(ROUGHNESS, "Rms over all spatial frequencies, or within sigma_band."),
                "sigma_band": Key(Listing(SPATIAL_FREQUENCY, 2, 2), "The band in which sigma holds.", needs="sigma"),
                "A": Key(Quantity(VOLUME, "0 nm3", "1 m3", "nm3"), "One-sided one-dimensional spectrum at f = 0."),
                "S0": Key(Quantity(LENGTH4, "0 nm4", "1 m4", "nm4"), "Two-dimensional spectrum at f = 0."),
                "B": _B,
                "C": _C,
            },
            alternatives=(("sigma",), ("A",), ("S0",)),
            name="psd, convention harvey",
        ),
        "scatmech": Section(
            {
                "convention": _CONVENTION,
                "A": Key(
                    Quantity(LENGTH4, "0 nm4", "1 m4", "nm4"), "Two-dimensional spectrum at f = 0.", required=True
                ),
                "B": _B,
                "C": Key(_STEEPER, "Slope of the two-dimensional spectrum.", required=True),
            },
            name="psd, convention scatmech",
        ),
        "zemax": Section(
            {
                "convention": _CONVENTION,
                "sigma": Key(ROUGHNESS, "Rms below the frequency 1/sigma_wavelength.", required=True),
                "sigma_wavelength": Key(WAVELENGTH, "The wavelength at which sigma holds.", required=True),
                "B": _B,
                "s": Key(_STEEPER, "Slope of the two-dimensional spectrum.", required=True),
            },
            name="psd, convention zemax",
        ),
        "measured": Section(
            {
                "convention": Key(_CONVENTIONS, "Said by files alone.", default="measured"),
                "files": Key(
                    Listing(Text(), 1, 100), "Measured spectra, from the directory of the system file.", required=True
                ),
                "terms": Key(Number(1, MOST_TERMS, whole=True), "K-correlations that are fitted, and add.", default=1),
                "gain_error": Key(
                    Number(0, 1),
                    f"Standard error of an instrument's gain, as of ln S; 0: no gains; default {GAIN_ERROR:g}.",
                ),
                "kind": Key(Word(KINDS), "Of files that do not say."),
                "frequency_unit": Key(Text(), "Of files that do not say, such as 1/mm."),
                "psd_unit": Key(Text(), "Of files that do not say, such as nm2 mm2."),
            },
            name="psd, measured",
        ),
    },
    signs={"files": "measured"},
)

_FINISH = {
    "psd": Key(Either(mapping=PSD, listing=Listing(PSD, 0, 100), listed=True), "Terms that add; none: smooth."),
    "reflectance": Key(Number(0, 1, beyond=True), "Enters the reported throughput only.", default=1),
    "incidence": Key(INCIDENCE, "Angle of incidence; multiplies the scatter by its cos^2.", default="0 deg"),
}

SURFACE = Section(
    {
        "name": Key(Text(), "What reports call it; default surface_1, surface_2, ..."),
        "marginal_height": Key(MARGINAL_HEIGHT, "Height of the marginal ray; the sign does not matter.", required=True),
        **_FINISH,
        "seidel": Key(SEIDEL, "This surface's part of the wavefront, in the same normalised coordinates."),
        "kind": Key(Word(("mirror", "refracting")), "What the surface does.", default="mirror"),
        "index": Key(Listing(INDEX, 2, 2), "Refractive index before and after; required when refracting."),
    },
    name="surfaces[]",
    refused=_SHAPES,
)

PRESCRIBED_SURFACE = Section(
    {"name": Key(Text(), "Which surface of the prescription; those not listed are smooth.", required=True), **_FINISH},
    name="surfaces[], with a prescription",
    refused=dict.fromkeys(("marginal_height", "seidel", "kind", "index"), _PRESCRIBED) | _SHAPES,
)

POINT = Section(
    {
        "radius": Key(FIELD, "Distance from the axis.", required=True),
        "azimuth": Key(AZIMUTH, "From +x towards +y.", default="90 deg"),
    },
    name="fields[]",
)

RANGE = Section(
    {
        "start": Key(FIELD, "First field, on +y.", required=True),
        "stop": Key(FIELD, "Last field, on +y.", required=True),
        "count": Key(Number(2, 10_000, whole=True), "How many, evenly spaced, both ends counted.", required=True),
    },
    name="fields (range)",
)

DETECTOR = Section(
    {
        "pixel": Key(Quantity(LENGTH, "1 nm", "1 m", "um"), "Width of a pixel.", required=True),
        "pixels": Key(Number(1, MOST_PIXELS, whole=True), "Pixels along each edge of the window.", required=True),
        "oversample": Key(Number(1, 99, whole=True), "Sub-samples per pixel edge; 1: no oversampled cube.", default=1),
        "centre": Key(
            Word(("middle", "pixel")),
            "Where the Gaussian image point lies: the middle of the window, or pixel N//2.",
            default="middle",
        ),
        "offset": Key(
            Listing(Quantity(SHIFT, "-1 m", "1 m", "um"), 2, 2),
            "[dx, dy], lengths or pix: moves the grid under the image.",
        ),
    },
    name="detector",
)

BOXES = Section(
    {"half_widths": Key(Listing(HALF_WIDTH, 1, 10_000), "Half widths that replace the default boxes.", required=True)},
    name="ensquared_energy",
)

TOLERANCE = Section(
    {
        "pixel": Key(Number(1e-12, 1), "Relative error of a pixel.", required=True),
        "ee": Key(Number(1e-12, 1), "Absolute error of an ensquared energy.", required=True),
    },
    name="accuracy",
)

FIELDS = Either(scalar=FIELD, mapping=RANGE, listing=Listing(Either(scalar=FIELD, mapping=POINT), 1, 10_000))

SYSTEM = Section(
    {
        "schema": Key(Number(1, 1, whole=True), "Version of this format.", required=True),
        "title": Key(Text(), "What reports call the system."),
        "wavelengths": Key(
            Either(scalar=WAVELENGTH, listing=Listing(WAVELENGTH, 1, 1000), listed=True),
            "One wavelength or a list.",
            required=True,
        ),
        "telescope": Key(
            ByPrescription(TELESCOPE, PRESCRIBED_TELESCOPE), "Conjugates, pupil and aberrations.", required=True
        ),
        "prescription": Key(PRESCRIPTION, "The surfaces as built; gives conjugates, marginal heights and aberrations."),
        "surfaces": Key(
            ByPrescription(Listing(SURFACE, 0, 1000), Listing(PRESCRIBED_SURFACE, 0, 1000)),
            "In the order light meets them; with a prescription in any order, for their finish alone.",
            required=True,
        ),
        "fields": Key(FIELDS, "Field points; a bare value lies on +y.", required=True),
        "detector": Key(DETECTOR, "The window and its pixels.", required=True),
        "ensquared_energy": Key(BOXES, "Boxes to report."),
        "accuracy": Key(Either(scalar=Word(tuple(PRESETS)), mapping=TOLERANCE), "How exact.", default="standard"),
    },
    name="(top)",
)
