"""The tables of psf.fits and its copy of the system file: headers by astropy, data as plain arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits

from psfcli.products.header import ascii_line
from psfcli.products.tables import EE_COLUMNS
from psfcli.products.units import DEG, NM, UM, converted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from psfcli.products.header import ImageSummary, RunHeader

_TABLE_LETTERS = {"f": "D", "i": "J", "S": "A"}  # of TFORM, by numpy's kind: float64, int32, text
_SPOT_COLUMNS = {
    "centroid_x": "centroid_x",
    "centroid_y": "centroid_y",
    "chief_x": "chief_x",
    "chief_y": "chief_y",
    "rms_x": "rms_x",
    "rms_y": "rms_y",
    "spot_x0": "x_min",
    "spot_x1": "x_max",
    "spot_y0": "y_min",
    "spot_y1": "y_max",
}


def fields_table(header: RunHeader, summaries: Sequence[ImageSummary]) -> tuple[fits.Header, NDArray[Any]]:
    """FIELDS: a row per field; what depends on the wavelength is [row], or [row, wavelength] for several."""
    count = len(header.wavelengths)
    shape = () if count == 1 else (count,)
    names = (*_SPOT_COLUMNS, "rms_r", "power_in_frame", "power_outside")
    rows = np.zeros(
        len(header.fields),
        [("index", ">i4"), ("field", ">f8"), ("azimuth", ">f8"), *((name, ">f8", shape) for name in names)],
    )
    for index, field in enumerate(header.fields):
        rows["index"][index] = index
        rows["field"][index] = header.field_value(field.radius)
        rows["azimuth"][index] = converted(field.azimuth, DEG)
    for summary in summaries:
        at = (summary.field_index, summary.wavelength_index)[: 1 + len(shape)]
        for name, attribute in _SPOT_COLUMNS.items():
            rows[name][at] = converted(getattr(summary.spot, attribute), UM)
        rows["rms_r"][at] = converted(math.hypot(summary.spot.rms_x, summary.spot.rms_y), UM)
        rows["power_in_frame"][at] = summary.power_in_frame
        rows["power_outside"][at] = summary.power_outside
    units = {"field": header.field_unit, "azimuth": "deg", **dict.fromkeys((*_SPOT_COLUMNS, "rms_r"), "um")}
    table = _table_header("FIELDS", rows.dtype, len(rows), units)
    table.add_comment("Positions from the Gaussian image point; rms about the centroid; azimuth from +x to +y.")
    table.add_comment("spot_x0 to spot_y1 bound what unscattered light touches.")
    table.add_comment("With several wavelengths a column has the shape [field, wavelength].")
    return table, rows


def ensquared_header(header: RunHeader, count: int) -> fits.Header:
    """The header of EE, a table of ``count`` rows with the columns of ee.csv, all float64."""
    units = {
        "wavelength_nm": "nm",
        "field": header.field_unit,
        "azimuth_deg": "deg",
        "half_width_um": "um",
        "width_px": "pix",
    }
    return _table_header("EE", np.dtype([(name, ">f8") for name in EE_COLUMNS]), count, units)


def surfaces_table(header: RunHeader) -> tuple[fits.Header, NDArray[Any]]:
    """SURFACES: a row per wavelength and surface."""
    names = [ascii_line(surface.name).encode() for surface in header.surfaces]
    rows = [
        (
            name,
            converted(surface.wavelength, NM),
            converted(surface.sigma_rel, NM),
            surface.g,
            surface.tis,
            converted(surface.magnified_distance),
            surface.reflectance,
        )
        for name, surface in zip(names, header.surfaces, strict=True)
    ]
    columns = ("wavelength", "sigma_rel", "g", "TIS", "d_j", "reflectance")
    dtype = np.dtype([("name", f"S{max([1, *map(len, names)])}"), *((column, ">f8") for column in columns)])
    units = {"wavelength": "nm", "sigma_rel": "nm", "d_j": "mm"}
    return _table_header("SURFACES", dtype, len(rows), units), np.array(rows, dtype=dtype)


def config_image(header: RunHeader) -> tuple[fits.Header, NDArray[np.uint8]]:
    """CONFIG: the effective system file, one byte of its UTF-8 a pixel."""
    text = np.frombuffer(header.config.encode(), dtype=np.uint8)
    cards = fits.ImageHDU(text, name="CONFIG").header
    cards.add_comment("The effective system file, as UTF-8.")
    return cards, text


def _table_header(name: str, dtype: np.dtype[Any], count: int, units: dict[str, str]) -> fits.Header:
    """The header of a binary table; put together here because astropy, given data, loads its tables too (0.1 s)."""
    cards = fits.BinTableHDU(name=name).header
    cards["NAXIS1"], cards["NAXIS2"], cards["TFIELDS"] = dtype.itemsize, count, len(dtype.names or ())
    for number, column in enumerate(dtype.names or (), start=1):
        element, shape = dtype[column].base, dtype[column].shape
        repeat = element.itemsize if element.kind == "S" else math.prod(shape)
        letter = _TABLE_LETTERS[element.kind]
        cards[f"TTYPE{number}"] = column
        cards[f"TFORM{number}"] = letter if repeat == 1 and not shape else f"{repeat}{letter}"
        if column in units:
            cards[f"TUNIT{number}"] = units[column]
    return cards
