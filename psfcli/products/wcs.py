"""Where the Gaussian image point lies on a pixel grid, and how FITS says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from psfcli.products.units import ARCSEC, converted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from psfcli.image.grid import Detector

    Card = tuple[str, str | float | int | None, str]


def gaussian_image_point(detector: Detector, oversample: int = 1) -> tuple[float, float]:
    """The FITS pixel coordinates (x, y) of the Gaussian image point: 1.0 is the centre of the first pixel.

    On the grid of ``oversample`` sub-pixels per pixel edge the same place is counted in sub-pixels.
    """
    count = detector.pixels
    still = (count + 1) / 2.0 if detector.centre == "middle" else count // 2 + 1.0
    # pixel i covers i - 1/2 to i + 1/2, on either grid
    x, y = ((still - shift / detector.pixel - 0.5) * oversample + 0.5 for shift in detector.offset)
    return converted(x), converted(y)


def coordinate_cards(detector: Detector, oversample: int, focal_length: float | None) -> Iterator[Card]:
    """The world-coordinate cards of a cube: arcsec and, as alternate A, mm from the Gaussian image point.

    At finite conjugates (``focal_length`` None) mm alone. The third axis counts fields from 0, as FIELDS does.
    """
    point = gaussian_image_point(detector, oversample)
    pixel = detector.pixel / oversample
    if focal_length is None:
        yield from _linear_cards("", "DETECTOR", point, converted(pixel), "mm")
        return
    yield from _linear_cards("", "SKY", point, converted(pixel / focal_length, ARCSEC), "arcsec")
    yield from _linear_cards("A", "DETECTOR", point, converted(pixel), "mm")


def _linear_cards(mark: str, name: str, point: tuple[float, float], step: float, unit: str) -> Iterator[Card]:
    yield f"WCSNAME{mark}", name, "from the Gaussian image point"
    for axis, (letter, reference) in enumerate(zip("XY", point, strict=True), start=1):
        yield f"CTYPE{axis}{mark}", letter, "linear"
        yield f"CUNIT{axis}{mark}", unit, ""
        yield f"CRPIX{axis}{mark}", reference, "Gaussian image point"
        yield f"CRVAL{axis}{mark}", 0.0, ""
        yield f"CDELT{axis}{mark}", step, ""
    yield f"CTYPE3{mark}", "FIELD", "index in FIELDS"
    yield f"CRPIX3{mark}", 1.0, ""
    yield f"CRVAL3{mark}", 0.0, ""
    yield f"CDELT3{mark}", 1.0, ""
