"""The headers of psf.fits that carry no table: the primary one and those of the cubes."""

from __future__ import annotations

import math
from dataclasses import fields
from itertools import chain
from typing import TYPE_CHECKING

from astropy.io import fits

from psfcli.products.header import RunHeader, ascii_line, versions
from psfcli.products.units import ARCSEC, DEG, NM, UM, M, converted
from psfcli.products.wcs import coordinate_cards
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from psfcli.products.wcs import Card

UNKNOWN_ERROR = 1e99
"""An error that could not be estimated: FITS has neither infinity nor nan, and this exceeds any allowance."""

_VERSION_CARDS = {"python": "VERPYTH", "numpy": "VERNUMPY", "scipy": "VERSCIPY", "astropy": "VERASTRO"}


def primary_header(header: RunHeader) -> fits.Header:
    """The primary header: the telescope, what was asked, and the versions that answered."""
    cards = fits.Header(
        [
            ("SIMPLE", True, "conforms to FITS standard"),
            ("BITPIX", 8, ""),
            ("NAXIS", 0, ""),
            ("EXTEND", True, ""),
            ("LONGSTRN", "OGIP 1.0", "long titles continue"),
            ("TITLE", ascii_line(header.title)),
        ]
    )
    told = (_telescope_cards(header), _grid_cards(header), _accuracy_cards(header.tolerance), _validity_cards(header))
    for card in chain(*told):
        cards.append(card)
    cards.append(("CREATOR", _creator(), ""))
    for name, key in _VERSION_CARDS.items():
        cards.append((key, versions()[name], f"version of {name}"))
    cards.append(("CONFSHA", header.config_sha256))
    return cards


def cube_header(header: RunHeader, wavelength_index: int, oversample: int) -> fits.Header:
    """The header of one cube, PSF when ``oversample`` is 1 and else PSF_OVER.

    It keeps its length when the errors reached are told, so it can hold its place before they are known.
    """
    edge = header.detector.pixels * oversample
    cards = fits.Header(
        [
            ("XTENSION", "IMAGE", "image extension"),
            ("BITPIX", -64, "64-bit floating point"),
            ("NAXIS", 3, ""),
            ("NAXIS1", edge, "x"),
            ("NAXIS2", edge, "y, in the direction of growing field"),
            ("NAXIS3", len(header.fields), "field"),
            ("PCOUNT", 0, ""),
            ("GCOUNT", 1, ""),
            ("EXTNAME", "PSF" if oversample == 1 else "PSF_OVER", ""),
            ("EXTVER", wavelength_index + 1, "counts the wavelengths"),
            ("BUNIT", "", "fraction of all light in each pixel"),
            ("WAVELEN", converted(header.wavelengths[wavelength_index], M), "[m] wavelength"),
        ]
    )
    focal_length = header.telescope.focal_length
    pixel = header.detector.pixel / oversample
    if focal_length is not None:
        scale = converted(pixel / focal_length, ARCSEC)
        cards.append(("FOCALLEN", converted(focal_length), "[mm] focal length"))
        cards.append(("PIXELSCL", scale, "[arcsec] width of a pixel of this HDU"))
    cards.append(("PIXSIZE", converted(pixel, UM), "[um] width of a pixel of this HDU"))
    cards.append(("OVERSAMP", oversample, "pixels of this HDU per detector pixel edge"))
    specular = header.specular_fractions[wavelength_index]
    cards.append(("SPECFRAC", specular, "specular fraction of all light"))
    for card in _accuracy_cards(header.tolerance):
        cards.append(card)
    tell_reached(cards, Tolerance(math.nan, math.nan))
    for card in coordinate_cards(header.detector, oversample, focal_length):
        cards.append(card)
    cards.append(("CREATOR", _creator(), ""))
    cards.append(("CONFSHA", header.config_sha256))
    return cards


def tell_reached(cards: fits.Header, reached: Tolerance) -> None:
    """Write the largest estimated errors over the fields into the header of a cube."""
    for key, error in (("ERRPIX", reached.pixel), ("ERREE", reached.ee)):
        cards[key] = (error if math.isfinite(error) else UNKNOWN_ERROR, "largest estimated error over the fields")


def _telescope_cards(header: RunHeader) -> Iterator[Card]:
    telescope = header.telescope
    if telescope.focal_length is not None:
        yield "FOCALLEN", converted(telescope.focal_length), "[mm] focal length"
        aperture = converted(2.0 * telescope.focal_length * telescope.image_slope)
        yield "APERTURE", aperture, "[mm] diameter of the entrance pupil"
    yield "IMSLOPE", converted(telescope.image_slope), "u', exit-pupil radius / image distance"
    yield "OBSCURE", converted(telescope.pupil.obscuration), "linear central obscuration"
    for key, azimuth in zip(("SECTOR1", "SECTOR2"), telescope.pupil.sector, strict=True):
        yield key, converted(azimuth, DEG), "[deg] lit sector of the pupil, from +x to +y"
    yield (
        "MAXFIELD",
        header.field_value(telescope.max_field),
        f"[{header.field_unit}] field of the Seidel table (H = 1)",
    )
    for term in fields(telescope.seidel):
        yield term.name, converted(getattr(telescope.seidel, term.name), NM), "[nm] wavefront coefficient"
    yield "THRUPUT", converted(header.throughput), "product of the reflectances"


def _grid_cards(header: RunHeader) -> Iterator[Card]:
    yield "NWAVE", len(header.wavelengths), "wavelengths"
    yield "NFIELD", len(header.fields), "fields"
    yield "PIXSIZE", converted(header.detector.pixel, UM), "[um] width of a detector pixel"
    yield "NPIXEL", header.detector.pixels, "detector pixels per edge"
    yield "OVERSAMP", header.detector.oversample, "sub-pixels per detector pixel edge"


def _accuracy_cards(asked: Tolerance) -> Iterator[Card]:
    yield "ACCPIX", asked.pixel, "asked relative error of a pixel"
    yield "ACCEE", asked.ee, "asked error of an ensquared energy"


def _validity_cards(header: RunHeader) -> Iterator[Card]:
    yield "VALID", not header.warnings, "all criteria of the model's validity are met"
    for number, warning in enumerate(header.warnings, start=1):
        yield f"WARN{number}", ascii_line(warning), ""


def _creator() -> str:
    return f"psfcli {versions()['psfcli']}"
