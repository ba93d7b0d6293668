"""Which PSD terms a scene does without, and how little that changes it.

A term has a phase variance a = (K sigma)^2 over all spatial frequencies. Were there no clip at the horizon, it would be
one more convolution: of light that stays where it is, and at most e^a - 1 that moves. The clip concerns separations
below a quarter of the wavelength, where the term's exponent is within +-eta of zero, eta <= a; there its part of the
transfer function changes by e^eta - 1 with a total variation of at most three times that. As a sum of discs |q| < Q,
whose transforms Q J1(2 pi Q r)/r hold at most 1.41 (a mean of differences of J0) in any rectangle, that is 4.3 times
e^eta - 1 of light. So without the term, with b of phase variance above the horizon in all others,

    any square's energy changes by at most  e^b [(e^a - 1) + 4.3 (e^eta - 1)].

A pixel far out may be lit by the term alone, however little light that is. So S is taken with and without it at every
distance that pixels ask for: |S - S'|/S is a bound for them, too, since convolution with PSF_G and integration over
pixels average it. There the clip takes no more than pi q^2 (e^b - 1), q = 1/(4 d_j) of the nearest surface, and changes
by no more than pi q^2 e^b (e^eta - 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.image.scatter import scatter_terms
from psfcli.surface.autocovariance import decorrelation
from psfcli.surface.harvey_shack import horizon, phase_per_height, phase_variance, phase_variance_beyond
from psfcli.surface.mixture import GaussianMixture, MixtureError, mixing_density, trapezoid_step
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]
Place = tuple[int, int]  # of a term: index of its surface, index in the surface's psd

FLOOR = 1e-30
"""Light below which a pixel need only not be negative (contract, section 4)."""
_CLIPPED = 0.25  # wavelengths: the clip acts at smaller separations alone
_CLIP_LIGHT = 4.3
_STEP_ERROR = 1e-2  # relative, of the densities compared and of their difference
_RADII_PER_E_FOLD = 8


@dataclass(frozen=True, slots=True)
class TermChange:
    """A PSD term, what the scene changes by at most without it alone, and whether it does without.

    ``change.pixel`` is nan where ``change.ee`` has decided.
    """

    place: Place
    change: Tolerance
    skipped: bool


@dataclass(frozen=True, slots=True)
class Smoothness:
    """The ``surfaces`` at a wavelength with the terms that are modelled; ``left_out`` bounds what the rest changes."""

    surfaces: tuple[Surface, ...]
    terms: tuple[TermChange, ...]
    left_out: Tolerance

    @property
    def scatters(self) -> bool:
        """Whether any term is modelled."""
        return any(surface.psd for surface in self.surfaces)


def smooth_enough(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, distance: float, allowed: Tolerance
) -> Smoothness:
    """The scatter at ``wavelength`` [mm] less the terms that together change nothing by more than ``allowed``.

    ``distance`` [mm] is the farthest that pixels ask for, 0 where none are asked for.
    """

    def change(places: Sequence[Place]) -> Tolerance:
        ee = energy_change(surfaces, places, wavelength)
        asked = ee <= allowed.ee
        pixel = pixel_change(surfaces, places, telescope, wavelength, distance) if asked else math.nan
        return Tolerance(pixel, min(ee, 1.0))

    places = [(j, i) for j, surface in enumerate(surfaces) for i in range(len(surface.psd))]
    alone = {place: change([place]) for place in places}
    skipped: list[Place] = []
    left_out = Tolerance(0.0, 0.0)
    for place in sorted(places, key=lambda place: alone[place].ee):
        together = change([*skipped, place]) if skipped else alone[place]
        if together.ee <= allowed.ee and together.pixel <= allowed.pixel:
            skipped.append(place)
            left_out = together
    terms = tuple(TermChange(place, alone[place], place in skipped) for place in places)
    return Smoothness(without(surfaces, skipped), terms, left_out)


def without(surfaces: Sequence[Surface], places: Sequence[Place]) -> tuple[Surface, ...]:
    """The surfaces less the terms at ``places``."""
    return tuple(
        replace(surface, psd=tuple(term for i, term in enumerate(surface.psd) if (j, i) not in places))
        for j, surface in enumerate(surfaces)
    )


def energy_change(surfaces: Sequence[Surface], places: Sequence[Place], wavelength: float) -> float:
    """A bound of what any ensquared energy changes by without the terms at ``places`` [fraction of all light]."""
    a, eta = _phase_variances(surfaces, places, wavelength)
    if a >= 1.0:
        return math.inf
    return math.exp(beyond_horizon(surfaces, wavelength)) * (math.expm1(a) + _CLIP_LIGHT * math.expm1(eta))


def pixel_change(
    surfaces: Sequence[Surface],
    places: Sequence[Place],
    telescope: Telescope,
    wavelength: float,
    distance: float,
) -> float:
    """A bound of the relative change of any pixel within ``distance`` [mm] without the terms at ``places``.

    Exact to a twentieth; inf where there is none.
    """
    if distance == 0.0 or energy_change(surfaces, places, wavelength) < FLOOR:
        return 0.0
    rest = without(surfaces, places)
    if not scatter_terms(rest, telescope, wavelength):
        return math.inf
    try:
        S, difference, error = _densities(surfaces, rest, telescope, wavelength, distance)
    except MixtureError:
        return math.inf
    b = beyond_horizon(surfaces, wavelength)
    _, eta = _phase_variances(surfaces, places, wavelength)
    nearest = min(s.index_after * telescope.magnified_distance(s.marginal_height) for s in surfaces if s.psd)
    clip = math.pi * (_CLIPPED / nearest) ** 2 if nearest > 0.0 else math.inf
    lit = S - clip * math.expm1(b)
    if not np.all(lit > 0.0):
        return math.inf
    scattered = float(np.max((np.abs(difference) + clip * math.exp(b) * math.expm1(eta)) / lit))
    unscattered = math.expm1(_mean_count(surfaces, wavelength) - _mean_count(rest, wavelength))
    return max((1.0 + 5.0 * _STEP_ERROR) * scattered + error, unscattered)


def _densities(
    surfaces: Sequence[Surface],
    rest: Sequence[Surface],
    telescope: Telescope,
    wavelength: float,
    distance: float,
) -> tuple[Real, Real, float]:
    """S of all ``surfaces`` at distances up to ``distance`` [mm], its excess over S of the ``rest``, and the error of

    their quotient; before the clip. Both are mixtures on one grid, coarse, for its error is relative to either.
    """
    terms, kept = (scatter_terms(some, telescope, wavelength) for some in (surfaces, rest))
    G, steepest = _mean_count(surfaces, wavelength), max(term.nu for term in terms)
    widths = [term.width for term in terms]
    low = 0.5 * min(widths) ** 2 / (steepest + 60.0)
    high = max(distance, *widths) ** 2 * _STEP_ERROR ** (-1.0 / (1.0 + min(term.nu for term in terms)))
    step = trapezoid_step(_STEP_ERROR, steepest, G)
    variance = np.exp(np.arange(math.log(low), math.log(high), step))
    whole, doubt = mixing_density(variance, terms, G)
    part, part_doubt = mixing_density(variance, kept, _mean_count(rest, wavelength))
    e_folds = max(math.log(distance**2 / low), 0.0)
    radius = distance * np.exp(-np.linspace(0.0, 0.5 * e_folds, 2 + int(_RADII_PER_E_FOLD * e_folds)))
    radius[-1] = 0.0
    S, difference = (GaussianMixture(step * c, variance).density(radius) for c in (whole, whole - part))
    return S, difference, doubt + part_doubt


def _mean_count(surfaces: Sequence[Surface], wavelength: float) -> float:
    """G, the mean number of scatterings."""
    return sum(phase_variance(surface, wavelength) for surface in surfaces)


def beyond_horizon(surfaces: Sequence[Surface], wavelength: float) -> float:
    """b, the phase variance above the horizon [1]: the unclipped transfer functions hold e^b of the light."""
    return sum(phase_variance_beyond(surface, wavelength) for surface in surfaces)


def _phase_variances(surfaces: Sequence[Surface], places: Sequence[Place], wavelength: float) -> tuple[float, float]:
    """The sums of a and of eta over the terms at ``places``."""
    a = eta = 0.0
    for j, i in places:
        surface, term = surfaces[j], surfaces[j].psd[i]
        K2 = phase_per_height(surface, wavelength) ** 2
        u = np.array([2.0 * math.pi * _CLIPPED / (horizon(surface, wavelength) * term.B)])
        lost = term.sigma**2 * float(decorrelation(u, 0.5 * (term.C - 1.0))[0])
        a += K2 * term.sigma**2
        eta += K2 * max(term.band_variance(horizon(surface, wavelength), math.inf), lost)
    return a, eta
