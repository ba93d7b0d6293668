"""What the paraxial rays of a prescription tell of scattered light: at which angles it arises, and what it misses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from psfcli.telescope.paraxial import ParaxialTrace
from psfcli.telescope.system import Field, Telescope


@dataclass(frozen=True, slots=True)
class Vignetting:
    """The ``angle`` [rad] from which on rays that a surface scatters begin to miss the ``next_surface``."""

    next_surface: str
    angle: float


def incidences(
    trace: ParaxialTrace, surface: str, telescope: Telescope, fields: Sequence[Field]
) -> tuple[float, float]:
    """The least and the largest angle of incidence [rad] on a surface over the lit pupil and the ``fields``.

    |i| <= |i_marginal| + H |ibar_chief|, and no less than the obscured part of the one leaves of the other. Paraxial.
    """
    marginal, chief = (abs(i) for i in trace.incidences[_place(trace, surface)])
    farthest = max(math.hypot(*telescope.relative_field(field)) for field in fields)
    least = max(telescope.pupil.obscuration * marginal - farthest * chief, 0.0)
    return least, marginal + farthest * chief


def mean_incidence(trace: ParaxialTrace, surface: str, telescope: Telescope, fields: Sequence[Field]) -> float:
    """The root mean square angle of incidence [rad] on a surface over the lit annulus and the ``fields``. Paraxial.

    <i^2> = i_marginal^2 (1 + obscuration^2)/2 + <H^2> ibar_chief^2: g goes with cos^2 i, so it is that of the surface's
    key ``incidence`` which scatters as much.
    """
    marginal, chief = trace.incidences[_place(trace, surface)]
    off_axis = sum(math.hypot(*telescope.relative_field(field)) ** 2 for field in fields) / len(fields)
    return math.sqrt(0.5 * (1.0 + telescope.pupil.obscuration**2) * marginal**2 + off_axis * chief**2)


def vignetting(trace: ParaxialTrace, surface: str, obscuration: float) -> Vignetting | None:
    """From where on rays of the axis that a surface scatters begin to miss the next one; None behind the last.

    The marginal ray, turned by alpha, arrives alpha t farther out, t the distance between the two. Clear apertures are
    no part of a prescription: the second mirror is taken to be what obscures the pupil, and no surface to be smaller
    than the beam of max_field needs. Off the axis rays begin to miss sooner.
    """
    j = _place(trace, surface)
    built = trace.prescription.surfaces
    if j + 1 == len(built):
        return None
    height, chief = abs(trace.marginal.heights[j + 1]), abs(trace.chief.heights[j + 1])
    clear = height + chief
    if j == 0 and built[0].is_mirror and built[1].is_mirror:
        clear = max(clear, obscuration * abs(trace.marginal.heights[0]))
    spacing = abs(built[j].thickness)
    return Vignetting(built[j + 1].name, math.atan2(clear - height, spacing))


def _place(trace: ParaxialTrace, surface: str) -> int:
    return [each.name for each in trace.prescription.surfaces].index(surface)
