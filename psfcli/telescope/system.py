"""The telescope as Eq. 26 and 37 see it: conjugates, pupil, aberrations, field points."""

from __future__ import annotations

import math
from dataclasses import dataclass

from psfcli.telescope.seidel import SeidelTable


@dataclass(frozen=True, slots=True)
class Pupil:
    """A uniformly lit annulus ``obscuration <= rho <= 1`` of the unit pupil, or a sector of it.

    ``sector`` holds the first and last azimuth [rad], from +x towards +y, first < last <= first + 2 pi.
    """

    obscuration: float = 0.0
    sector: tuple[float, float] = (0.0, 2.0 * math.pi)

    @property
    def is_full_annulus(self) -> bool:
        """Whether every azimuth is lit."""
        return self.sector[1] - self.sector[0] >= 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class Field:
    """A field point: signed distance from the axis and azimuth.

    ``radius`` is an angle [rad] (object at infinity) or an object height [mm] (finite conjugates) and may be
    negative; ``azimuth`` [rad] is measured from +x towards +y, so a plain field angle has azimuth pi/2.
    """

    radius: float
    azimuth: float = math.pi / 2.0


@dataclass(frozen=True, slots=True)
class Telescope:
    """A telescope reduced to what third-order imaging needs.

    ``image_slope`` is u' = n' (exit-pupil radius)/(image distance) = D/(2 f) for an object at infinity [1];
    ``focal_length`` [mm] is None at finite conjugates, where ``max_field`` and fields are heights [mm] and not
    angles [rad].
    """

    image_slope: float
    pupil: Pupil
    seidel: SeidelTable
    max_field: float
    focal_length: float | None

    @property
    def object_at_infinity(self) -> bool:
        """Whether fields are angles."""
        return self.focal_length is not None

    def relative_field(self, field: Field) -> tuple[float, float]:
        """The normalised field vector (H_x, H_y): ratio of tangents for angles, of heights otherwise [1]."""
        if self.object_at_infinity:
            relative = math.tan(field.radius) / math.tan(self.max_field)
        else:
            relative = field.radius / self.max_field
        # sin and cos of pi/2 must give exactly (0, H) for the plain field angles
        return relative * math.sin(math.pi / 2.0 - field.azimuth), relative * math.sin(field.azimuth)

    def magnified_distance(self, marginal_height: float) -> float:
        """d_j = z' |h_j|/h = |h_j|/u' [mm] of a surface with the given marginal ray height [mm] (below Eq. 37)."""
        return abs(marginal_height) / self.image_slope
