"""The bytes before the pixels of a multi-part OpenEXR file of uncompressed scan lines."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_MAGIC = 20000630
_VERSION_2_MULTIPART = 2 | 0x1000
_FLOAT32 = 2
# one channel: name, pixel type, not linear, no sub-sampling; a zero byte ends the list
_CHANNELS = b"Y\0" + struct.pack("<iB3xii", _FLOAT32, 0, 1, 1) + b"\0"


@dataclass(frozen=True, slots=True)
class Part:
    """A square image of ``edge`` pixels with its name and string attributes."""

    name: str
    edge: int
    attributes: Mapping[str, str]

    @property
    def line_type(self) -> np.dtype[np.void]:
        """A scan line as it lies in the file: part number, row from the top, bytes of pixels, pixels."""
        return np.dtype([("part", "<i4"), ("row", "<i4"), ("size", "<i4"), ("Y", "<f4", (self.edge,))])

    @property
    def size(self) -> int:
        """The bytes of all scan lines."""
        return self.edge * self.line_type.itemsize


def file_header(parts: Sequence[Part]) -> bytes:
    """Everything before the first scan line: the headers of the parts and where each of their lines begins."""
    # all parts must agree in the display window; the largest shows the whole of each
    display = max(part.edge for part in parts)
    headers = b"".join(_part_header(part, display) for part in parts) + b"\0"
    start = struct.pack("<ii", _MAGIC, _VERSION_2_MULTIPART)
    sizes = np.repeat([part.line_type.itemsize for part in parts], [part.edge for part in parts])
    first = len(start) + len(headers) + 8 * sizes.size
    offsets = first + np.cumsum(sizes) - sizes
    return b"".join((start, headers, offsets.astype("<u8").tobytes()))


def _part_header(part: Part, display: int) -> bytes:
    header = [
        _attribute("channels", "chlist", _CHANNELS),
        _attribute("chunkCount", "int", struct.pack("<i", part.edge)),
        _attribute("compression", "compression", b"\0"),
        _attribute("dataWindow", "box2i", _window(part.edge)),
        _attribute("displayWindow", "box2i", _window(display)),
        _attribute("lineOrder", "lineOrder", b"\0"),
        _attribute("name", "string", part.name.encode()),
        _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        _attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0)),
        _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
        _attribute("type", "string", b"scanlineimage"),
        *(_attribute(name, "string", text.encode()) for name, text in part.attributes.items()),
    ]
    return b"".join(header) + b"\0"


def _window(edge: int) -> bytes:
    return struct.pack("<4i", 0, 0, edge - 1, edge - 1)


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
