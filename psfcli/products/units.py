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
