"""Which aberration coefficients a scene does without, because of how little they displace the light.

Unscattered light has sharp edges, so no bound holds for it but where it all stays in one cell of the grid and in every
square asked for, with every aberration there is. Scattered light is smooth. Displaced by delta, a term of width w,
order nu = (C - 1)/2 and phase variance below e^b changes

- the energy in any square by at most delta e^b Gamma(nu + 1/2)/(sqrt(pi) Gamma(nu) w), the mean over its Gaussians,
  v = w^2/2t, of the total variation delta/sqrt(2 pi v); the clip at the horizon, made of discs |q| < 1/(4 d_j), adds at
  most 3 delta (e^b - 1)/d_j;
- a pixel, relatively, by at most exp[delta (C + 1)/(2 w)] - 1, the steepest descent of ln S2, at x = w: a convolution
  of several terms is nowhere steeper than the steepest of them. Twice that covers the clip for distances r with
  (r/d_j)^(C + 1) < (C - 1)/10; pixels farther out have no bound.

Squares may stand about the chief ray or the centroid, which move too: twice delta.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from psfcli.image.grid import Detector
from psfcli.image.scatter import scatter_terms
from psfcli.planning.smoothness import beyond_horizon
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """How an image changes when light is displaced: ``ee`` and ``pixel`` per mm, for small displacements.

    ``unscattered`` is the light with sharp edges, and ``clearance`` [mm] the displacement that it does not notice.
    """

    ee: float
    pixel: float
    unscattered: float
    clearance: float

    def change(self, displacement: float, farthest: float) -> Tolerance:
        """A bound of what a ``displacement`` [mm] changes, where all aberrations displace by ``farthest`` [mm]."""
        jump = 0.0 if farthest < self.clearance else self.unscattered
        exponent = self.pixel * displacement
        return Tolerance(
            pixel=math.expm1(exponent) if exponent < 1.0 else math.inf, ee=min(jump + self.ee * displacement, 1.0)
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
    ee = pixel = 0.0
    for wavelength, surfaces in scattering.items():
        b = beyond_horizon(surfaces, wavelength)
        for surface in surfaces:
            d = telescope.magnified_distance(surface.marginal_height)
            for term in scatter_terms([surface], telescope, wavelength):
                if d == 0.0:
                    return Sensitivity(math.inf, math.inf, unscattered, 0.0)
                lost = math.exp(math.lgamma(term.nu + 0.5) - math.lgamma(term.nu)) / (math.sqrt(math.pi) * term.width)
                ee = max(ee, 2.0 * (math.exp(b) * lost + 3.0 * math.expm1(b) / d))
                smooth = (distance / d) ** (2.0 * term.nu + 2.0) < 0.2 * term.nu
                pixel = max(pixel, 2.0 * (term.nu + 1.0) / term.width if smooth else math.inf)
    return Sensitivity(
        ee, 0.0 if detector is None else pixel, unscattered, min(0.5 * smallest_box, _to_an_edge(detector))
    )


def negligible(sizes: Mapping[str, float], worth: Sensitivity, allowed: Tolerance) -> tuple[frozenset[str], Tolerance]:
    """The coefficients that together change nothing by more than ``allowed``, and a bound of what they change."""
    farthest = sum(sizes.values())
    skipped = {name for name, size in sizes.items() if size == 0.0}
    left_out = Tolerance(0.0, 0.0)
    for name in sorted(sizes.keys() - skipped, key=lambda name: (sizes[name], name)):
        together = worth.change(sizes[name] + sum(sizes[other] for other in skipped), farthest)
        if together.ee > allowed.ee or together.pixel > allowed.pixel:
            break
        skipped.add(name)
        left_out = together
    return frozenset(skipped), left_out


def without_coefficients(telescope: Telescope, names: frozenset[str]) -> Telescope:
    """The telescope less some coefficients of its Seidel table."""
    return replace(telescope, seidel=replace(telescope.seidel, **dict.fromkeys(names, 0.0)))


def _to_an_edge(detector: Detector | None) -> float:
    """The distance from the Gaussian image point to the nearest edge of a sub-pixel of the window, or beyond [mm]."""
    if detector is None:
        return math.inf
    phases = [detector.start(axis) / detector.sub_pixel % 1.0 for axis in (0, 1)]
    return detector.sub_pixel * min(min(phase, 1.0 - phase) for phase in phases)
