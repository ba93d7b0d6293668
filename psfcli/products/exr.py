"""psf.exr: the images as float32 for tools that read OpenEXR.

Uncompressed: ZIP saves 2 % and costs 7 times.
"""

from __future__ import annotations

import errno
import os
from mmap import ACCESS_READ, mmap
from typing import TYPE_CHECKING

import numpy as np
import OpenEXR

from psfcli.products.header import ascii_line
from psfcli.products.units import DEG, NM, UM, converted
from psfcli.products.wcs import gaussian_image_point

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO, NoReturn

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

    OpenEXR wants all images of a file at once, and 64 fields of several wavelengths may be more than the memory
    holds; so they wait on the disk, which needs room for every plane twice, and only one image is ever held here.
    """

    def __init__(self, stage: Stage, header: RunHeader) -> None:
        count = len(header.fields)
        starts = range(0, count, FIELDS_PER_FILE)
        names = ["psf.exr"] if len(starts) == 1 else [f"psf_{number:03d}.exr" for number in range(len(starts))]
        self._stage = stage
        self._files = {
            name: _ExrFile(stage.announce(name), stage.scratch(), header, start)
            for name, start in zip(names, starts, strict=True)
        }
        self._positive = self._lost = self._subnormal = 0

    def add(self, wavelength_index: int, field_index: int, image: FieldImage) -> None:
        """Take the planes of one image; a file that they complete is written."""
        name, file = list(self._files.items())[field_index // FIELDS_PER_FILE]
        for oversampled, plane in enumerate((image.psf, image.psf_over)):
            if plane is not None:
                single = file.keep(wavelength_index, field_index, bool(oversampled), plane)
                self._count_underflow(plane, single)
        if file.is_complete:
            file.write()
            self._stage.seal(name)

    def finish(self) -> str | None:
        """A remark when float32 cannot hold some values."""
        if not self._lost and not self._subnormal:
            return None
        return (
            f"psf.exr: {self._lost + self._subnormal} of {self._positive} positive values are below {_SMALLEST:.2g}, "
            f"too small for float32: {self._lost} became 0, {self._subnormal} lost digits; psf.fits has them in full"
        )

    def _count_underflow(self, plane: NDArray[np.float64], single: NDArray[np.float32]) -> None:
        if single.min() >= _SMALLEST:
            self._positive += plane.size
            return
        positive = int(np.count_nonzero(plane > 0.0))
        kept = int(np.count_nonzero(single > 0.0))
        self._positive += positive
        self._lost += positive - kept
        self._subnormal += kept - int(np.count_nonzero(single >= _SMALLEST))


class _ExrFile:
    """One file: its parts in order, and the planes kept on the disk until ``write``."""

    def __init__(self, path: Path, scratch: BinaryIO, header: RunHeader, first: int) -> None:
        self._path = path
        self._header = header
        detector = header.detector
        # (oversampled, wavelength, field), in the order of the parts
        self._keys = [
            (oversampled, wavelength, field)
            for oversampled in ((False,) if detector.oversample == 1 else (False, True))
            for wavelength in range(len(header.wavelengths))
            for field in range(first, min(first + FIELDS_PER_FILE, len(header.fields)))
        ]
        self._edges = [detector.sub_pixels if oversampled else detector.pixels for oversampled, _, _ in self._keys]
        sizes = 4 * np.array(self._edges, dtype=np.int64) ** 2
        starts = (np.cumsum(sizes) - sizes).tolist()
        self._starts = dict(zip(self._keys, starts, strict=True))
        self._sums: dict[tuple[bool, int, int], float] = {}
        self._scratch = scratch

    @property
    def is_complete(self) -> bool:
        """Whether every plane is there."""
        return len(self._sums) == len(self._keys)

    def keep(self, wavelength: int, field: int, oversampled: bool, plane: NDArray[np.float64]) -> NDArray[np.float32]:
        """Keep the plane, its top row the largest y, as float32 [row, x]; what was kept comes back."""
        key = (oversampled, wavelength, field)
        single = np.ascontiguousarray(plane[::-1], dtype=np.float32)
        self._scratch.seek(self._starts[key])
        self._scratch.write(single.data)
        self._sums[key] = float(plane.sum())
        return single

    def write(self) -> None:
        """Write the file; raises OSError."""
        with self._scratch:
            self._scratch.flush()
            planes = self._planes()
            parts = [self._part(*key, plane) for key, plane in zip(self._keys, planes, strict=True)]
            try:
                OpenEXR.File(parts).write(str(self._path))
            except RuntimeError:
                self._raise_reason()
        # OpenEXR says nothing when it could not write the end: the last row, its bytes, its pixels
        edge = self._edges[-1]
        end = np.array([edge - 1, 4 * edge], "<i4").tobytes() + planes[-1][-1].tobytes()
        if not _ends_with(self._path, end):
            self._raise_reason()

    def _planes(self) -> list[NDArray[np.float32]]:
        """Every plane [row, x], mapped: the pages are the system's to drop and read again."""
        mapped = mmap(self._scratch.fileno(), 0, access=ACCESS_READ)
        return [
            np.frombuffer(mapped, np.float32, edge * edge, self._starts[key]).reshape(edge, edge)
            for key, edge in zip(self._keys, self._edges, strict=True)
        ]

    def _part(self, oversampled: bool, wavelength: int, field: int, plane: NDArray[np.float32]) -> OpenEXR.Part:
        wave = f"wave_{wavelength:02d}_" if len(self._header.wavelengths) > 1 else ""
        # all parts must agree in the display window; the largest shows the whole of each
        corners = np.zeros(2, np.int32), np.full(2, max(self._edges) - 1, np.int32)
        attributes = {
            "compression": OpenEXR.NO_COMPRESSION,
            "type": OpenEXR.scanlineimage,
            "displayWindow": corners,
            **_attributes(self._header, oversampled, wavelength, field),
            "sum": repr(self._sums[oversampled, wavelength, field]),
        }
        return OpenEXR.Part(attributes, {"Y": plane}, f"{wave}field_{field:02d}{'_over' if oversampled else ''}")

    def _raise_reason(self) -> NoReturn:
        """Raise the OSError that OpenEXR keeps to itself: what stopped it stops us too where it stopped."""
        with self._path.open("ab") as stream:
            stream.write(bytes(1 << 16))
        raise OSError(errno.EIO, "OpenEXR could not write it", str(self._path))


def _attributes(header: RunHeader, oversampled: bool, wavelength: int, field: int) -> dict[str, str]:
    """What a part says of itself; strings, because readers make float32 of numbers."""
    detector = header.detector
    oversample = detector.oversample if oversampled else 1
    x, y = gaussian_image_point(detector, oversample)
    return {
        "title": ascii_line(header.title),
        "wavelength": f"{converted(header.wavelengths[wavelength], NM)!r} nm",
        "field": f"{header.field_value(header.fields[field].radius)!r} {header.field_unit}",
        "azimuth": f"{converted(header.fields[field].azimuth, DEG)!r} deg",
        "pixel_um": repr(converted(detector.pixel / oversample, UM)),
        "centre_x": repr(converted(x - 1.0)),
        "centre_y": repr(converted(detector.pixels * oversample - y)),
    }


def _ends_with(path: Path, end: bytes) -> bool:
    with path.open("rb") as stream:
        stream.seek(-len(end), os.SEEK_END)
        return stream.read() == end
