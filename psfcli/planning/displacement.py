"""Whether a scene does without its aberrations, because of how little they displace the light.

All of them, or none: a few coefficients less would save nothing. They displace rays by at most delta. Unscattered light
has sharp edges, so no bound holds for it but where all of it stays in one cell of the grid and in every square asked
for. Scattered light is smooth. Displaced by delta, a term of width w, order nu = (C - 1)/2 and phase variance below e^b
changes

- the energy in a square about it by at most 0.49 nu e^b (delta/w)^2: for a Gaussian N(v) it falls by no more than
  0.243 delta^2/v, and the mean of 1/v is 2 nu/w^2; the clip at the horizon, made of discs |q| < 1/(4 d_j), adds at most
  3 delta (e^b - 1)/d_j;
- a pixel, relatively, by at most exp[delta (C + 1)/(2 w)] - 1, the steepest descent of ln S2, at x = w: a convolution
  of several terms is nowhere steeper than the steepest of them. Twice that covers the clip for distances r with
  (r/d_j)^(C + 1) < (C - 1)/10; pixels farther out have no bound.

Squares may stand about the chief ray or the centroid, which move too: twice delta.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from psfcli.image.grid import Detector
from psfcli.image.scatter import scatter_terms
from psfcli.planning.smoothness import beyond_horizon
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """How an image changes when its light is displaced from the Gaussian image point.

    Of an energy by ``curvature`` [1/mm^2] times the square of the displacement and ``clip`` [1/mm] times itself, of ln
    of a pixel by ``slope`` [1/mm] times it. ``unscattered`` is the light with sharp edges, and ``clearance`` [mm] the
    displacement that it does not notice.
    """

    curvature: float
    clip: float
    slope: float
    unscattered: float
    clearance: float

    def change(self, displacement: float) -> Tolerance:
        """A bound of what a ``displacement`` [mm] above 0 of all light changes; inf where there is none."""
        jump = 0.0 if displacement < self.clearance else self.unscattered
        exponent = self.slope * displacement
        return Tolerance(
            pixel=math.expm1(exponent) if exponent < 1.0 else math.inf,
            ee=min(jump + self.curvature * displacement**2 + self.clip * displacement, 1.0),
        )


def displacements(telescope: Telescope, fields: Sequence[Field]) -> dict[str, float]:
    """A bound of the transverse ray error of each coefficient within max_field, or to the farthest field beyond [mm].

    The same for every subset of the fields within max_field, so that a sweep in parts gives the numbers of the whole.
    """
    farthest = max([1.0, *(math.hypot(*telescope.relative_field(field)) for field in fields)])
    W = telescope.seidel
    slopes = {
        "W020": 2.0 * abs(W.W020),
        "W040": 4.0 * abs(W.W040),
        "W131": 3.0 * abs(W.W131) * farthest,
        "W222": 2.0 * abs(W.W222) * farthest**2,
        "W220": 2.0 * abs(W.W220) * farthest**2,
        "W311": abs(W.W311) * farthest**3,
    }
    return {name: slope / telescope.image_slope for name, slope in slopes.items()}


def sensitivity(
    scattering: Mapping[float, Sequence[Surface]],
    telescope: Telescope,
    unscattered: float,
    detector: Detector | None,
    smallest_box: float,
) -> Sensitivity:
    """What displaced light changes, in the worst of the wavelengths [mm] and the surfaces that scatter at each.

    ``unscattered`` is the largest share of it; ``detector`` None: no pixels are asked for; ``smallest_box`` [mm] is
    the least half width, inf where no squares are asked for.
    """
    distance = 0.0 if detector is None else detector.farthest()
    curvature = clip = slope = 0.0
    for wavelength, surfaces in scattering.items():
        b = beyond_horizon(surfaces, wavelength)
        for surface in surfaces:
            d = telescope.magnified_distance(surface.marginal_height)
            for term in scatter_terms([surface], telescope, wavelength):
                if d == 0.0:
                    return Sensitivity(math.inf, math.inf, math.inf, unscattered, 0.0)
                curvature = max(curvature, 0.49 * term.nu * math.exp(b) * (2.0 / term.width) ** 2)
                clip = max(clip, 6.0 * math.expm1(b) / d)
                smooth = (distance / d) ** (2.0 * term.nu + 2.0) < 0.2 * term.nu
                slope = max(slope, 2.0 * (term.nu + 1.0) / term.width if smooth else math.inf)
    clearance = min(0.5 * smallest_box, _to_an_edge(detector))
    return Sensitivity(curvature, clip, 0.0 if detector is None else slope, unscattered, clearance)


def _to_an_edge(detector: Detector | None) -> float:
    """The distance from the Gaussian image point to the nearest edge of a sub-pixel of the window, or beyond [mm]."""
    if detector is None:
        return math.inf
    phases = [detector.start(axis) / detector.sub_pixel % 1.0 for axis in (0, 1)]
    return detector.sub_pixel * min(min(phase, 1.0 - phase) for phase in phases)
