"""Ensquared energy as a table, the same numbers for ee.csv and for the EE table of psf.fits."""

from __future__ import annotations

import csv
from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.units import DEG, NM, UM, converted

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import BinaryIO

    from numpy.typing import NDArray

    from psfcli.image.result import EnsquaredEnergy, FieldImage
    from psfcli.products.header import ImageSummary, RunHeader

    _Key = tuple[float, float, float]  # wavelength [nm], field [deg or mm], azimuth [deg]
    _Place = tuple[int, int]  # wavelength index, field index

EE_COLUMNS = (
    "wavelength_nm",
    "field",
    "azimuth_deg",
    "half_width_um",
    "width_px",
    "ee",
    "ee_chief",
    "ee_centroid",
    "ee_unaberrated",
)


class CsvProduct:
    """An ee.csv being written to ``stream``; ``add`` the images in any order.

    Plain CSV: the header, then every float with the digits that give it back. The rows of an image are written as soon
    as those of all before it are: of images that come in the table's order nothing is kept.
    """

    def __init__(self, stream: BinaryIO, header: RunHeader) -> None:
        self._stream = stream
        self._pixel = header.detector.pixel
        self._due = deque(_listed(header))
        self._listed = {place for _, place in self._due}
        self._waiting: dict[_Place, EnsquaredEnergy] = {}
        stream.write(",".join(EE_COLUMNS).encode() + b"\n")

    def add(self, wavelength_index: int, field_index: int, image: FieldImage) -> None:
        """Write the rows of one image, and of those that waited for it, or let them wait for their turn."""
        if (wavelength_index, field_index) in self._listed:
            self._waiting[wavelength_index, field_index] = image.ensquared
        while self._due and self._due[0][1] in self._waiting:
            key, place = self._due.popleft()
            self._stream.write(_lines(_block(key, self._waiting.pop(place), self._pixel)).encode())


def ensquared_rows(header: RunHeader, summaries: Sequence[ImageSummary]) -> list[NDArray[np.float64]]:
    """The rows of the table, one block [box, column] per image, in the units its columns name.

    Blocks are sorted by wavelength, field and azimuth, rows by half width; nothing comes twice.
    """
    boxes = {(summary.wavelength_index, summary.field_index): summary.ensquared for summary in summaries}
    return [_block(key, boxes[place], header.detector.pixel) for key, place in _listed(header)]


def read_csv(path: Path) -> NDArray[np.float64]:
    """The table of an ee.csv as [row, column]; raises OSError, csv.Error, or ValueError where it is another one."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = csv.reader(stream)
        header = next(rows, [])
        if tuple(header) != EE_COLUMNS:
            raise ValueError(f"{path.name} starts {','.join(header)[:40]!r}, not {','.join(EE_COLUMNS)[:40]!r}")
        return np.array([[float(value) for value in row] for row in rows]).reshape(-1, len(EE_COLUMNS))


def _listed(header: RunHeader) -> list[tuple[_Key, _Place]]:
    """Wavelength [nm], field and azimuth [deg] of the images the table lists, sorted, and which images they are."""
    images: dict[_Key, _Place] = {}
    for w, wavelength in enumerate(header.wavelengths):
        for f, field in enumerate(header.fields):
            key = converted(wavelength, NM), header.field_value(field.radius), converted(field.azimuth, DEG)
            images.setdefault(key, (w, f))
    return sorted(images.items())


def _lines(block: NDArray[np.float64]) -> str:
    rows = zip(*(_digits(column.tobytes()) for column in block.T), strict=True)
    return "".join([",".join(row) + "\n" for row in rows])


@lru_cache(maxsize=4 * len(EE_COLUMNS))  # half the columns of one image are those of the next
def _digits(column: bytes) -> list[str]:
    return repr(np.frombuffer(column).tolist())[1:-1].split(", ")  # a third faster than one repr after the other


def _block(key: _Key, boxes: EnsquaredEnergy, pixel: float) -> NDArray[np.float64]:
    chosen, sizes = _box_sizes(tuple(boxes.half_width.tolist()), pixel)
    rows = np.empty((len(chosen), len(EE_COLUMNS)))
    rows[:, :3] = key
    rows[:, 3:5] = sizes
    for column, energies in enumerate((boxes.ee, boxes.ee_chief, boxes.ee_centroid, boxes.ee_unaberrated), start=5):
        rows[:, column] = energies[chosen]
    return rows


@lru_cache(maxsize=8)  # the boxes of one image are those of the next
def _box_sizes(half_widths: tuple[float, ...], pixel: float) -> tuple[list[int], NDArray[np.float64]]:
    """Which boxes to list, and their half widths [um] and widths [pixel] as [box, 2]; sorted, none twice."""
    boxes = {converted(w, UM): (index, converted(2.0 * w / pixel)) for index, w in enumerate(half_widths)}
    listed = sorted((half_width, width, index) for half_width, (index, width) in boxes.items())
    return [index for _, _, index in listed], np.array([(half_width, width) for half_width, width, _ in listed])
