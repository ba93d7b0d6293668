"""Ensquared energy as a table, the same numbers for ee.csv and for the EE table of psf.fits."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.units import DEG, NM, UM, converted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import BinaryIO

    from numpy.typing import NDArray

    from psfcli.products.header import ImageSummary, RunHeader

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


def ensquared_rows(header: RunHeader, summaries: Sequence[ImageSummary]) -> list[NDArray[np.float64]]:
    """The rows of the table, one block [box, column] per image, in the units its columns name.

    Blocks are sorted by wavelength, field and azimuth, rows by half width; nothing comes twice.
    """
    images: dict[tuple[float, float, float], ImageSummary] = {}
    for summary in summaries:
        field = header.fields[summary.field_index]
        wavelength = converted(header.wavelengths[summary.wavelength_index], NM)
        images.setdefault((wavelength, header.field_value(field.radius), converted(field.azimuth, DEG)), summary)
    return [_block(key, images[key], header.detector.pixel) for key in sorted(images)]


def write_csv(stream: BinaryIO, blocks: Iterable[NDArray[np.float64]]) -> None:
    """Write the table as plain CSV: the header, then every float with the digits that give it back."""
    stream.write(",".join(EE_COLUMNS).encode() + b"\n")
    for block in blocks:
        stream.write("".join(_lines(block)).encode())


def _lines(block: NDArray[np.float64]) -> Iterator[str]:
    for row in zip(*(_digits(column.tobytes()) for column in block.T), strict=True):
        yield ",".join(row) + "\n"


@lru_cache(maxsize=4 * len(EE_COLUMNS))  # half the columns of one image are those of the next
def _digits(column: bytes) -> list[str]:
    return [repr(value) for value in np.frombuffer(column).tolist()]


def _block(key: tuple[float, float, float], summary: ImageSummary, pixel: float) -> NDArray[np.float64]:
    boxes = summary.ensquared
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
