"""The symmetries of a square, and an image turned or mirrored by one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.image.grid import Detector
from psfcli.image.result import FieldImage, Spot

Real = NDArray[np.float64]

_SAME = 1e-12  # of the window: edges as near as this are one edge


@dataclass(frozen=True, slots=True)
class Symmetry:
    """One of the eight: (x, y) swapped to (y, x) or not, then each kept (1) or mirrored (-1)."""

    swap: bool = False
    x: int = 1
    y: int = 1

    @property
    def inverse(self) -> Symmetry:
        """What undoes it."""
        return Symmetry(True, self.y, self.x) if self.swap else self

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Where (x, y) goes; no zero comes back negative."""
        if self.swap:
            x, y = y, x
        return self.x * x + 0.0, self.y * y + 0.0

    def azimuth(self, azimuth: float) -> float:
        """Where the direction ``azimuth`` [rad], from +x towards +y, goes."""
        if self.swap:
            azimuth = 0.5 * math.pi - azimuth
        if self.x < 0:
            azimuth = math.pi - azimuth
        return self.y * azimuth

    def keeps(self, detector: Detector) -> bool:
        """Whether it maps the detector's window, and with it every sub-pixel, onto the window."""
        x_start, x_stop, y_start, y_stop = detector.bounds()
        corners = [self.point(x_start, y_start), self.point(x_stop, y_stop)]
        lowest = min(x for x, _ in corners), min(y for _, y in corners)
        return math.dist(lowest, (x_start, y_start)) <= _SAME * (x_stop - x_start)

    def plane(self, values: Real) -> Real:
        """An image [y, x] turned or mirrored."""
        if self.swap:
            values = values.T
        return np.ascontiguousarray(values[:: self.y, :: self.x])

    def spot(self, spot: Spot) -> Spot:
        """A spot turned or mirrored."""
        x_ends, y_ends = (spot.x_min, spot.x_max), (spot.y_min, spot.y_max)
        xs, ys = zip(*(self.point(x, y) for x, y in zip(x_ends, y_ends, strict=True)), strict=True)
        rms_x, rms_y = (spot.rms_y, spot.rms_x) if self.swap else (spot.rms_x, spot.rms_y)
        return Spot(
            *self.point(spot.centroid_x, spot.centroid_y),
            *self.point(spot.chief_x, spot.chief_y),
            rms_x,
            rms_y,
            min(xs),
            max(xs),
            min(ys),
            max(ys),
        )

    def image(self, image: FieldImage) -> FieldImage:
        """The image of a field point turned or mirrored; the light in squares and outside the window is the same.

        Valid where it ``keeps`` the detector, or where no pixels were computed.
        """
        if self == Symmetry():
            return image
        return replace(
            image,
            psf=None if image.psf is None else self.plane(image.psf),
            psf_over=None if image.psf_over is None else self.plane(image.psf_over),
            spot=self.spot(image.spot),
        )


SYMMETRIES = tuple(Symmetry(swap, x, y) for swap in (False, True) for x in (1, -1) for y in (1, -1))
"""All eight, doing nothing first."""
