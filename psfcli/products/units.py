"""From the units used inside (mm, rad) to the units the products are written in."""

from __future__ import annotations

import math

M = 1e-3
UM = 1e3
NM = 1e6
DEG = 180.0 / math.pi
ARCSEC = 3600.0 * DEG


def converted(value: float, factor: float = 1.0) -> float:
    """``value * factor``, rounded to 15 significant digits.

    The round-off of a conversion stays out of the products: 9.4 nm, kept as 9.4e-6 mm, is 9.4 again and not
    9.399999999999999. Minus zero becomes zero.
    """
    return float(f"{value * factor:.15g}") + 0.0


def field_name(radius: float, azimuth: float, *, at_infinity: bool) -> str:
    """A field as reports call it, with its ``azimuth`` [rad] where that is not +y.

    ``radius`` is an angle [rad] for an object ``at_infinity``, and else an object height [mm].
    """
    name = f"{DEG * radius:.6g}°" if at_infinity else f"{radius:.6g} mm"
    return name if abs(azimuth - 0.5 * math.pi) <= 1e-12 else f"{name} at azimuth {DEG * azimuth:.6g}°"
