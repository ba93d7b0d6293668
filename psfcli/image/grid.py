"""The detector's grid: where pixels lie about the Gaussian image point, odd and even, shifted or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Detector:
    """A square window of pixels x pixels, each ``pixel`` wide [mm].

    ``centre`` "middle": the Gaussian image point lies in the middle of the window (a pixel corner when
    ``pixels`` is even); "pixel": on the centre of pixel index pixels//2 (0-based). ``offset`` [mm] moves the grid
    under the image. ``oversample``: sub-pixels per pixel edge.
    """

    pixel: float
    pixels: int
    oversample: int = 1
    centre: Literal["middle", "pixel"] = "middle"
    offset: tuple[float, float] = (0.0, 0.0)
