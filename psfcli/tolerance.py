"""The two numbers a user asks for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Asked accuracy: relative error of a pixel, and absolute error of an ensquared energy (contract, section 4)."""

    pixel: float
    ee: float


PRESETS = {
    "draft": Tolerance(pixel=3e-2, ee=1e-3),
    "standard": Tolerance(pixel=1e-3, ee=1e-5),
    "reference": Tolerance(pixel=1e-6, ee=1e-8),
}
