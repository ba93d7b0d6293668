"""The products of a run read back, for its picture."""

from __future__ import annotations

import csv
import json
import warnings
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from psfcli.pictures.energy import EnergyCurve
from psfcli.pictures.run import Row, Window
from psfcli.products.tables import EE_COLUMNS, read_csv
from psfcli.products.target import EE_TABLE, FITS, MANIFEST, products_in

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

WINDOWS = 4, 16
"""Widths in pixels of the windows drawn unless others are asked for: those of the paper's Figs. 8 and 9."""
MOST_ROWS = 8
"""Wavelengths on a sheet; of more, so many of them, evenly spread."""
_UP = 90.0  # the azimuth [deg] of plain fields


class ReadingError(Exception):
    """What cannot be read or is not there; one line that says why."""


def read_rows(directory: Path, field: int | None, pixels: Sequence[int]) -> tuple[str, list[Row]]:
    """A title, and what a sheet shows of the run in ``directory``: a row for each wavelength, increasing.

    Images of the field with index ``field`` (None: the last) on windows of ``pixels`` x ``pixels`` about the Gaussian
    image point (none given: WINDOWS, as far as the image goes), where psf.fits holds any, and the ensquared energies
    of all fields. Raises ReadingError.
    """
    if not directory.is_dir():
        problem = "is a file" if directory.exists() else "does not exist"
        raise ReadingError(f"{directory}: {problem}; give the directory that psfcli run wrote")
    names = products_in(directory)
    if not names:
        raise ReadingError(f"{directory}: holds no products of psfcli run")
    if MANIFEST not in names:
        raise ReadingError(f"{directory}: holds an incomplete run (no {MANIFEST}); psfcli run --overwrite completes it")
    if not {FITS, EE_TABLE} & set(names):
        raise ReadingError(
            f"{directory}: holds neither {FITS} nor {EE_TABLE}, which psfcli run --format fits,csv writes"
        )
    if FITS not in names and (field is not None or pixels):
        raise ReadingError(f"{directory}: holds no {FITS}, and so no image for --field or --pixels")
    try:
        title = json.loads((directory / MANIFEST).read_text(encoding="utf-8"))["title"] or "Untitled system"
        if FITS in names:
            name, rows = _fits_rows(directory / FITS, field, pixels)
            return f"{title}; images of {name}", rows
        waves = _by(read_csv(directory / EE_TABLE), 1)
        return title, [_row(waves[w], None, ()) for w in _chosen(len(waves))]
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, csv.Error, Warning) as fault:
        reason = " ".join(str(fault).split()) or type(fault).__name__
        raise ReadingError(f"{directory}: cannot be read: {reason}") from fault


def _fits_rows(path: Path, field: int | None, pixels: Sequence[int]) -> tuple[str, list[Row]]:
    """The name of the field whose images are shown, and the rows."""
    from astropy.io import fits  # here, for a table of energies does without

    # astropy warns of a truncated file and goes on; mapped, the cubes would fill the memory as they are read
    with warnings.catch_warnings(action="error"), path.open("rb") as file, fits.open(file, memmap=False) as opened:
        cards, table, energies = opened[0].header, opened["FIELDS"], opened["EE"].data
        count, edge, unit = len(table.data), cards["NPIXEL"], table.columns["field"].unit
        if field is not None and field >= count:
            raise ReadingError(f"--field {field}: the products hold the fields 0 to {count - 1}")
        for width in pixels:
            if width > edge:
                raise ReadingError(f"--pixels {width}: the images have {edge} x {edge} pixels")
        index = count - 1 if field is None else field
        waves = _by(np.stack([energies[name] for name in EE_COLUMNS], axis=1).astype(np.float64), 1)
        finest = "PSF_OVER" if cards["OVERSAMP"] > 1 else "PSF"
        cubes = sorted((hdu for hdu in opened if hdu.name == finest), key=lambda hdu: hdu.header["WAVELEN"])
        widths = pixels or sorted({min(width, edge) for width in WINDOWS})
        rows = [
            _row(waves[w], unit, [_window(cubes[w], index, width) for width in widths]) for w in _chosen(len(waves))
        ]
        name = _field_name(table.data["field"][index], table.data["azimuth"][index], unit)
    return name, rows


def _window(cube: Any, field: int, pixels: int) -> Window:
    """The ``pixels`` x ``pixels`` detector pixels about the Gaussian image point, as near to it as the image allows."""
    scale, cell = cube.header["OVERSAMP"], cube.header["PIXSIZE"]
    starts, edges = [], []
    for axis in (1, 2):
        point = cube.header[f"CRPIX{axis}"] - 0.5  # in cells from the first edge
        most = cube.header[f"NAXIS{axis}"] // scale - pixels
        start = scale * min(max(round(point / scale - 0.5 * pixels), 0), most)
        starts.append(start)
        edges.append(cell * (start - point + np.arange(scale * pixels + 1.0)))
    x, y = (slice(start, start + scale * pixels) for start in starts)
    fraction = cube.section[field, y, x].astype(np.float64)
    return Window(f"{pixels} x {pixels} pixels", fraction, edges[0], edges[1], cell * scale)


def _row(energies: NDArray[np.float64], unit: str | None, windows: Sequence[Window]) -> Row:
    """What is drawn of one wavelength; ``energies`` are its rows of the table, with EE_COLUMNS."""
    column = {name: place for place, name in enumerate(EE_COLUMNS)}
    fields = _by(energies, 3)
    curves = [
        EnergyCurve(
            _field_name(rows[0, column["field"]], rows[0, column["azimuth_deg"]], unit),
            rows[:, column["half_width_um"]],
            rows[:, column["ee"]],
        )
        for rows in fields
    ]
    unaberrated = EnergyCurve("no aberrations", curves[0].half_width, fields[0][:, column["ee_unaberrated"]])
    pixel = 2.0 * energies[0, column["half_width_um"]] / energies[0, column["width_px"]]
    return Row(f"{energies[0, 0]:.6g} nm", tuple(windows), tuple(curves), unaberrated, pixel)


def _by(rows: NDArray[np.float64], columns: int) -> list[NDArray[np.float64]]:
    """Rows that follow each other with the same first ``columns``, together."""
    return [np.array(list(same)) for _, same in groupby(rows, key=lambda row: tuple(row[:columns]))]


def _chosen(waves: int) -> list[int]:
    return (
        list(range(waves)) if waves <= MOST_ROWS else np.linspace(0, waves - 1, MOST_ROWS).round().astype(int).tolist()
    )


def _field_name(radius: float, azimuth: float, unit: str | None) -> str:
    """A field as it is called in legends, with its azimuth where that is not +y; ``unit`` None: a CSV tells none."""
    name = f"{radius:.6g}°" if unit == "deg" else f"field {radius:.6g} {unit or ''}".rstrip()
    return name if abs(azimuth - _UP) < 1e-9 else f"{name} at {azimuth:.6g}°"
