"""Which of the spatial frequencies that an image uses nobody measured."""

from __future__ import annotations

import math
from collections.abc import Iterable

Band = tuple[float, float]


def image_band(nearest: float, farthest: float, wavelengths: Iterable[float], magnified_distance: float) -> Band:
    """The spatial frequencies [cycles/mm] that light uses to land ``nearest`` to ``farthest`` from the image [mm].

    f = x/(lambda d_j), at most 1/lambda, at the ``wavelengths`` [mm] and the ``magnified_distance`` d_j [mm] of a
    surface, which is not 0.
    """
    listed = list(wavelengths)
    longest, shortest = max(listed), min(listed)
    return (
        min(nearest / magnified_distance, 1.0) / longest,
        min(farthest / magnified_distance, 1.0) / shortest,
    )


def gaps(measured: Iterable[Band], band: Band) -> list[Band]:
    """The parts of ``band`` that lie in none of the bands ``measured``, in order."""
    at, last = band
    found = []
    for low, high in sorted(measured):
        if low > at and at < last:
            found.append((at, min(low, last)))
        at = max(at, high)
    if at < last:
        found.append((at, last))
    return found


def remark(measured: Iterable[Band], band: Band) -> str:
    """What to tell of an image that uses ``band`` [cycles/mm]: empty where all of it is measured."""
    missing = gaps(measured, band)
    if not missing:
        return ""
    unknown = math.fsum(math.log(high / low) for low, high in missing) / math.log(band[1] / band[0])
    listed = " and ".join(f"{low:.4g}..{high:.4g}" for low, high in missing)
    return (
        f"the detector, from one pixel to its farthest corner, uses {band[0]:.4g}..{band[1]:.4g} cycles/mm; nobody "
        f"measured {listed} cycles/mm ({100.0 * unknown:.0f} % of the band in log f), where the fit extrapolates"
    )
