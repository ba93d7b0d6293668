"""psf.exr: the images as float32 for tools that read OpenEXR, written image by image.

Uncompressed (ZIP saves 2 % and costs 7 times), so every scan line has its place before the first image is there,
and a run of any length needs the memory of one image. OpenEXR's own writer wants all images of a file at once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.exr_header import Part, file_header
from psfcli.products.header import ascii_line
from psfcli.products.units import DEG, NM, UM, converted
from psfcli.products.wcs import gaussian_image_point

if TYPE_CHECKING:
    from typing import BinaryIO

    from numpy.typing import NDArray

    from psfcli.image.result import FieldImage
    from psfcli.products.atomic import Stage
    from psfcli.products.header import RunHeader

FIELDS_PER_FILE = 64
_SMALLEST = float(np.finfo(np.float32).tiny)


class ExrProduct:
    """The OpenEXR files of a run; ``add`` the images in any order, then ``finish``.

    One psf.exr or, for more than 64 fields, psf_000.exr with the first 64 fields of every wavelength, and so on. In
    a file all detector grids come before all oversampled ones, each by wavelength, then field.
    """

    def __init__(self, stage: Stage, header: RunHeader) -> None:
        count = len(header.fields)
        starts = range(0, count, FIELDS_PER_FILE)
        names = ["psf.exr"] if len(starts) == 1 else [f"psf_{number:03d}.exr" for number in range(len(starts))]
        self._files = [
            _ExrFile(stage.open(name), header, range(start, min(start + FIELDS_PER_FILE, count)))
            for name, start in zip(names, starts, strict=True)
        ]
        self._positive = self._lost = self._subnormal = 0

    def add(self, wavelength_index: int, field_index: int, image: FieldImage) -> None:
        """Write the planes of one image to their places."""
        file = self._files[field_index // FIELDS_PER_FILE]
        for oversampled, plane in enumerate((image.psf, image.psf_over)):
            if plane is not None:
                single = file.write(wavelength_index, field_index, bool(oversampled), plane)
                self._count_underflow(plane, single)

    def finish(self) -> str | None:
        """Write the headers; a remark when float32 cannot hold some values."""
        for file in self._files:
            file.finish()
        if not self._lost and not self._subnormal:
            return None
        return (
            f"psf.exr: {self._lost + self._subnormal} of {self._positive} positive values are below {_SMALLEST:.2g}, "
            f"too small for float32: {self._lost} became 0, {self._subnormal} lost digits; psf.fits has them in full"
        )

    def _count_underflow(self, plane: NDArray[np.float64], single: NDArray[np.float32]) -> None:
        positive = int(np.count_nonzero(plane > 0.0))
        kept = int(np.count_nonzero(single > 0.0))
        self._positive += positive
        self._lost += positive - kept
        self._subnormal += kept - int(np.count_nonzero(single >= _SMALLEST))


class _ExrFile:
    """One file: the parts in order, and where the lines of each begin [byte]."""

    def __init__(self, stream: BinaryIO, header: RunHeader, fields: range) -> None:
        self._stream = stream
        keys = [
            (oversampled, wavelength, field)
            for oversampled in ((False,) if header.detector.oversample == 1 else (False, True))
            for wavelength in range(len(header.wavelengths))
            for field in fields
        ]
        self._parts = [_part(header, *key) for key in keys]
        self._numbers = {key: number for number, key in enumerate(keys)}
        sizes = [part.size for part in self._parts]
        self._starts = len(file_header(self._parts)) + np.cumsum(sizes) - sizes

    def write(self, wavelength: int, field: int, oversampled: bool, plane: NDArray[np.float64]) -> NDArray[np.float32]:
        """Write the plane, its top row the largest y; what was written comes back as float32 [row, x]."""
        number = self._numbers[oversampled, wavelength, field]
        part = self._parts[number]
        lines = np.empty(part.edge, part.line_type)
        lines["part"] = number
        lines["row"] = np.arange(part.edge)
        lines["size"] = 4 * part.edge
        lines["Y"] = plane[::-1]
        self._stream.seek(int(self._starts[number]))
        self._stream.write(lines.data)
        self._parts[number] = replace(part, attributes={**part.attributes, "sum": _fixed(float(plane.sum()))})
        single: NDArray[np.float32] = lines["Y"]
        return single

    def finish(self) -> None:
        """Write the header, which now has every sum."""
        self._stream.seek(0)
        self._stream.write(file_header(self._parts))


def _part(header: RunHeader, oversampled: bool, wavelength: int, field: int) -> Part:
    detector = header.detector
    oversample = detector.oversample if oversampled else 1
    edge = detector.pixels * oversample
    x, y = gaussian_image_point(detector, oversample)
    wave = f"wave_{wavelength:02d}_" if len(header.wavelengths) > 1 else ""
    # strings, because readers make float32 of numbers
    attributes = {
        "title": ascii_line(header.title),
        "wavelength": f"{converted(header.wavelengths[wavelength], NM)!r} nm",
        "field": f"{header.field_value(header.fields[field].radius)!r} {header.field_unit}",
        "azimuth": f"{converted(header.fields[field].azimuth, DEG)!r} deg",
        "pixel_um": repr(converted(detector.pixel / oversample, UM)),
        "centre_x": repr(converted(x - 1.0)),
        "centre_y": repr(converted(edge - y)),
        "sum": _fixed(0.0),
    }
    return Part(f"{wave}field_{field:02d}{'_over' if oversampled else ''}", edge, attributes)


def _fixed(value: float) -> str:
    """A number in as many characters whatever its size: a header keeps its length when the sum is known."""
    return f"{value:<23.16e}"
