"""How two psf.fits differ, read in pieces: a cube may be larger than the memory."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits

from psfcli.products.differences import ROUND_OFF, Difference, difference, ensquared_difference, mismatch
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

FLOOR = 1e-30
"""Energies below are promised to be below, no more."""
PICOMETRE = 1e-6
"""Absolute difference allowed between lengths in um: a centroid that is 0 by cancellation is 0 to that."""

_VALUES_AT_A_TIME = 1 << 21
_NOT_COMPARED = {"TITLE", "LONGSTRN", "CREATOR", "CONFSHA", "CHECKSUM", "DATASUM", "COMMENT", "HISTORY", ""}
_NOT_COMPARED_STARTS = ("VER", "ACC", "ERR", "VALID", "WARN")


def asked_accuracy(path: Path) -> Tolerance:
    """The accuracy that a psf.fits was asked for; raises KeyError or OSError where it does not say."""
    cards = fits.getheader(path)
    return Tolerance(float(cards["ACCPIX"]), float(cards["ACCEE"]))


def fits_differences(a: Path, b: Path, tolerance: Tolerance) -> list[Difference]:
    """The differences of two psf.fits: a line per cube and table column, and one per header card that differs.

    Raises ValueError, KeyError, TypeError or OSError when they are unreadable or of different shape.
    """
    found: list[Difference] = []
    # astropy warns of a truncated file and goes on; mapped, the cubes would fill the memory as they are read
    with (
        warnings.catch_warnings(action="error"),
        fits.open(a, memmap=False) as first,
        fits.open(b, memmap=False) as second,
    ):
        names = [[(hdu.name, hdu.ver) for hdu in opened] for opened in (first, second)]
        if names[0] != names[1]:
            odd = sorted(set(names[0]) ^ set(names[1]))
            raise ValueError(f"only one has {', '.join(f'{name} {version}' for name, version in odd)}")
        for one, other in zip(first, second, strict=True):
            label = f"{one.name} {one.ver}" if one.name.startswith("PSF") else one.name
            found += _hdu_differences(label, one, other, first["FIELDS"].data, second["FIELDS"].data, tolerance)
    return found


def _hdu_differences(
    label: str, a: Any, b: Any, fields_a: Any, fields_b: Any, tolerance: Tolerance
) -> list[Difference]:
    if a.name == "CONFIG":
        return []
    if a.name.startswith("PSF"):
        if a.shape != b.shape:
            raise ValueError(f"{label} is {a.shape} against {b.shape}")
        boxes = [_touched(hdu, table) for hdu, table in ((a, fields_a), (b, fields_b))]
        data = [_cube_difference(label, a, b, boxes, tolerance)]
    elif a.is_image:
        data = []
    else:
        data = _table_differences(a, b, tolerance)
    return data + _card_differences(label, a.header, b.header)


def _touched(hdu: Any, table: Any) -> NDArray[np.int64]:
    """The pixels that unscattered light touches with their neighbours, as [field, (x0, x1, y0, y1)], 0-based.

    The first and the one after the last; not clipped to the window.
    """
    step = hdu.header["PIXSIZE"]
    bounds = []
    for axis, letter in enumerate("xy", start=1):
        for mark, end in enumerate("01"):
            spot = table[f"spot_{letter}{end}"].reshape(len(table), -1)[:, hdu.ver - 1]
            # pixel i covers i to i + 1; light on an edge touches the pixels on either side
            edges = spot / step + hdu.header[f"CRPIX{axis}"] - 0.5
            bounds.append(np.floor(edges + ROUND_OFF) + 2.0 if mark else np.ceil(edges - ROUND_OFF) - 2.0)
    return np.stack(bounds, axis=1).astype(np.int64)


def _cube_difference(label: str, a: Any, b: Any, boxes: list[NDArray[np.int64]], tolerance: Tolerance) -> Difference:
    found = Difference(label)
    fields, rows, columns = a.shape
    step = max(1, _VALUES_AT_A_TIME // columns)
    x, y = np.arange(columns), np.arange(rows)
    for field in range(fields):
        x_touched = _either(x, [box[field, :2] for box in boxes])
        y_touched = _either(y, [box[field, 2:] for box in boxes])
        for start in range(0, rows, step):
            piece = slice(start, start + step)
            extra = tolerance.ee * np.logical_and.outer(y_touched[piece], x_touched)
            values = (hdu.section[field, piece, :].astype(np.float64) for hdu in (a, b))
            found = found.joined(difference(label, *values, relative=tolerance.pixel, absolute=extra, floor=FLOOR))
    return found


def _either(places: NDArray[np.int64], ranges: list[NDArray[np.int64]]) -> NDArray[np.bool_]:
    first, end = min(r[0] for r in ranges), max(r[1] for r in ranges)
    inside: NDArray[np.bool_] = (places >= first) & (places < end)
    return inside


def _table_differences(a: Any, b: Any, tolerance: Tolerance) -> list[Difference]:
    if a.columns.names != b.columns.names or len(a.data) != len(b.data):
        raise ValueError(
            f"{a.name} has {len(a.data)} rows of {a.columns.names} against {len(b.data)} of {b.columns.names}"
        )
    found = []
    for column in a.columns.names:
        one, other = a.data[column], b.data[column]
        if one.shape != other.shape:
            raise ValueError(f"{a.name} {column} is {one.shape} against {other.shape}")
        found.append(_column_difference(a.name, column, one, other, tolerance))
    return found


def _column_difference(table: str, column: str, a: NDArray[Any], b: NDArray[Any], tolerance: Tolerance) -> Difference:
    label = f"{table} {column}"
    if a.dtype.kind not in "fi":
        return mismatch(label, a, b)
    a, b = a.astype(np.float64), b.astype(np.float64)
    if table == "EE":
        return ensquared_difference(label, column, a, b, tolerance)
    if column.startswith("power"):
        return difference(label, a, b, relative=tolerance.pixel, absolute=tolerance.ee)
    return difference(label, a, b, relative=ROUND_OFF, absolute=PICOMETRE if table == "FIELDS" else 0.0)


def _card_differences(label: str, a: Any, b: Any) -> list[Difference]:
    found = []
    for key in dict.fromkeys([*a, *b]):
        if key in _NOT_COMPARED or key.startswith(_NOT_COMPARED_STARTS):
            continue
        one, other = a.get(key), b.get(key)
        if one != other:
            found.append(_card_difference(f"{label} {key}", one, other))
    return found


def _card_difference(label: str, a: Any, b: Any) -> Difference:
    if isinstance(a, float | int) and isinstance(b, float | int):
        return difference(label, np.array([float(a)]), np.array([float(b)]), relative=ROUND_OFF)
    return Difference(label, math.inf, math.inf, math.inf, 1, 1)
