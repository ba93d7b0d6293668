"""psf.fits, written plane by plane: every size is known before the first image, so each plane has its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.checksum import byte_sum, encoded, folded, word_sum
from psfcli.products.fits_cards import cube_header, primary_header, tell_reached
from psfcli.products.fits_tables import config_image, ensquared_header, fields_table, surfaces_table
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import BinaryIO

    from astropy.io import fits
    from numpy.typing import NDArray

    from psfcli.image.result import FieldImage
    from psfcli.products.header import ImageSummary, RunHeader

_BLOCK = 2880


@dataclass(slots=True)
class _Cube:
    """One cube of the file: where its header and planes lie [byte], and the sum of the words written so far."""

    wavelength_index: int
    oversample: int
    cards: fits.Header
    header_at: int
    data_at: int
    plane_size: int
    words: int = 0


class FitsProduct:
    """A psf.fits being written to ``stream``; ``add`` the images in any order, then ``finish``."""

    def __init__(self, stream: BinaryIO, header: RunHeader) -> None:
        self._stream = stream
        self._header = header
        self._cubes: list[_Cube] = []
        self._end = self._stream.write(_with_checksums(primary_header(header), 0))
        scales = sorted({1, header.detector.oversample})
        edges = {scale: header.detector.pixels * scale for scale in scales}
        self._swapped = {scale: np.empty((edge, edge), ">f8") for scale, edge in edges.items()}
        for wavelength_index in range(len(header.wavelengths)):
            for oversample in scales:
                self._lay_out(wavelength_index, oversample)

    def _lay_out(self, wavelength_index: int, oversample: int) -> None:
        cards = cube_header(self._header, wavelength_index, oversample)
        data_at = self._end + len(_with_checksums(cards, 0))
        plane_size = 8 * (self._header.detector.pixels * oversample) ** 2
        self._cubes.append(_Cube(wavelength_index, oversample, cards, self._end, data_at, plane_size))
        self._end = data_at + _padded(plane_size * len(self._header.fields))

    def add(self, wavelength_index: int, field_index: int, image: FieldImage) -> None:
        """Write the planes of one image to their places."""
        for cube in self._cubes:
            if cube.wavelength_index == wavelength_index:
                plane = image.psf if cube.oversample == 1 else image.psf_over
                self._write_plane(cube, field_index, plane)

    def _write_plane(self, cube: _Cube, field_index: int, plane: NDArray[np.float64] | None) -> None:
        if plane is None or 8 * plane.size != cube.plane_size:
            raise ValueError("an image without the planes its detector asks for")
        native = np.ascontiguousarray(plane, dtype=np.float64)
        cube.words += word_sum(native)
        self._stream.seek(cube.data_at + field_index * cube.plane_size)
        # into an array made once: a new one for each plane would cost more than the swap
        swapped = self._swapped[cube.oversample]
        swapped[...] = native
        self._stream.write(swapped.view(np.uint8).data)

    def finish(self, summaries: Sequence[ImageSummary], ensquared: Iterable[NDArray[np.float64]]) -> None:
        """Write all headers and, behind the cubes, the tables; ``ensquared`` are the blocks of the EE table."""
        for cube in self._cubes:
            mine = [s.reached for s in summaries if s.wavelength_index == cube.wavelength_index]
            # numpy's max, unlike Python's, does not lose a nan
            reached = Tolerance(float(np.max([r.pixel for r in mine])), float(np.max([r.ee for r in mine])))
            tell_reached(cube.cards, reached)
            self._stream.seek(cube.header_at)
            self._stream.write(_with_checksums(cube.cards, cube.words))
        # a file shorter than its last cube's padding ends in zeros all the same
        self._stream.truncate(self._end)
        self._stream.seek(self._end)
        blocks = list(ensquared)
        self._append(*_parts(*fields_table(self._header, summaries)))
        self._append(ensquared_header(self._header, sum(map(len, blocks))), [b.astype(">f8").tobytes() for b in blocks])
        self._append(*_parts(*surfaces_table(self._header)))
        self._append(*_parts(*config_image(self._header)))

    def _append(self, cards: fits.Header, parts: Sequence[bytes]) -> None:
        # only the last part may end inside a 32-bit word
        self._stream.write(_with_checksums(cards, sum(map(byte_sum, parts))))
        for part in parts:
            self._stream.write(part)
        size = sum(map(len, parts))
        self._stream.write(bytes(_padded(size) - size))


def _parts(cards: fits.Header, data: NDArray[np.generic]) -> tuple[fits.Header, list[bytes]]:
    return cards, [data.tobytes()]


def _padded(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK


def _with_checksums(cards: fits.Header, words: int) -> bytes:
    """The header as bytes, its CHECKSUM and DATASUM those of data whose 32-bit words sum to ``words``."""
    cards["DATASUM"] = (str(folded(words)), "sum of the words of the data")
    cards["CHECKSUM"] = ("0" * 16, "brings the sum of the HDU to zero")
    cards["CHECKSUM"] = encoded(byte_sum(cards.tostring().encode("ascii")) + words)
    return bytes(cards.tostring().encode("ascii"))
