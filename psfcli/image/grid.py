"""The detector's grid: where pixels lie about the Gaussian image point, odd and even, shifted or not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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

    @property
    def sub_pixels(self) -> int:
        """Sub-pixels along an edge of the window."""
        return self.pixels * self.oversample

    @property
    def sub_pixel(self) -> float:
        """Width of a sub-pixel [mm]."""
        return self.pixel / self.oversample

    def start(self, axis: Literal[0, 1]) -> float:
        """The coordinate of the window's first edge, x (axis 0) or y (axis 1), about the Gaussian image point [mm]."""
        middle = 0.5 * self.pixels if self.centre == "middle" else self.pixels // 2 + 0.5
        return self.offset[axis] - middle * self.pixel

    def bounds(self) -> tuple[float, float, float, float]:
        """The window's x_start, x_stop, y_start, y_stop about the Gaussian image point [mm]."""
        x, y = self.start(0), self.start(1)
        width = self.pixels * self.pixel
        return x, x + width, y, y + width

    def farthest(self) -> float:
        """The distance of the window's farthest corner from the Gaussian image point [mm]."""
        x_start, x_stop, y_start, y_stop = self.bounds()
        return math.hypot(max(-x_start, x_stop), max(-y_start, y_stop))

    def edges(self, axis: Literal[0, 1]) -> NDArray[np.float64]:
        """The edges of the sub-pixels along x (axis 0) or y (axis 1) about the Gaussian image point [mm]."""
        import numpy as np  # here, so that reading a system file does not load it

        return self.start(axis) + self.sub_pixel * np.arange(self.sub_pixels + 1.0)
