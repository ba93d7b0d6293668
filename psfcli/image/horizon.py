"""What the horizon takes away: roughness finer than the wavelength does not scatter (the clip of H at 1).

Near q = 0 the analytic transfer functions exceed 1 by the roughness beyond 1/lambda; the model clips them. The clip
subtracts D(r) = 2 pi Int_0^qc q J0(2 pi q r) [unclipped - clipped] dq from the scatter, a pedestal smooth on the scale
of d_j. Relative to S it grows as (r/d_j)^(C+1): nothing near the image, and at reference accuracy not negligible in the
corners of a large detector.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.image.quadrature import gauss_panels
from psfcli.surface.harvey_shack import phase_variance, phase_variance_beyond, transfer_exponent
from psfcli.surface.mixture import GaussianMixture, ScatterTerm
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_LOG_HUGE = 700.0
_VANISHED = 1e-3  # of the density before the clip: where less is left, ripples are all there is
_FADING = 3.0  # power of the distance by which the fit cares less beyond the farthest horizon
_MOST_RIPPLES = 2000.0  # of J0 within reach; beyond, D is not resolved


@dataclass(frozen=True, slots=True)
class HorizonLoss:
    """D(r) as wide Gaussians of either sign, and what the fit leaves at distances ``radius`` [mm].

    ``left`` is relative to the scatter, shape of ``radius``; ``energy`` is that of all it leaves.
    """

    mixture: GaussianMixture
    radius: Real
    left: Real
    energy: float

    @classmethod
    def ignored(cls, change: Tolerance) -> HorizonLoss:
        """Nothing taken, and the ``change`` that this is left as an error everywhere."""
        return cls(GaussianMixture(np.empty(0), np.empty(0)), np.zeros(1), np.full(1, change.pixel), change.ee)


def clip_change(
    surfaces: Sequence[Surface], terms: Sequence[ScatterTerm], telescope: Telescope, wavelength: float, reach: float
) -> Tolerance:
    """A bound of what the clip takes from any density within ``reach`` [mm], relative, and from any square there.

    |D| <= D(0) <= pi qc^2 (e^b - 1), qc the highest clip and b the phase variance beyond all horizons. S is nowhere
    less than what the ``terms`` of the surfaces scatter once, e^-G sum_i a_i nu_i/(pi w_i^2) [1 + (r/w_i)^2]^-(nu_i+1),
    least at r = ``reach``. 0 where no roughness lies beyond; a bound of 1 or more says nothing.
    """
    b = sum(phase_variance_beyond(s, wavelength) for s in surfaces)
    clip = float(np.max(_clips(surfaces, telescope, wavelength), initial=0.0))
    if b == 0.0 or clip == 0.0:
        return Tolerance(0.0, 0.0)
    once = [
        math.log(term.phase_variance * term.nu / math.pi)
        - 2.0 * math.log(term.width)
        - (term.nu + 1.0) * math.log1p((reach / term.width) ** 2)
        for term in terms
    ]
    G = sum(phase_variance(s, wavelength) for s in surfaces)
    log_taken = math.log(math.pi * clip**2) + (b if b > 1.0 else math.log(math.expm1(b)))
    pixel = math.exp(min(log_taken + G - float(np.logaddexp.reduce(once)), _LOG_HUGE))
    of_all = min(log_taken + math.log(2.0 * reach**2), b + math.log(pixel))  # the largest square, the light it holds
    return Tolerance(pixel, math.exp(min(of_all, 0.0)))


def horizon_loss(
    surfaces: Sequence[Surface],
    telescope: Telescope,
    wavelength: float,
    scatter: GaussianMixture,
    reach: float,
) -> HorizonLoss:
    """D(r) for r <= ``reach`` [mm], to be taken from the ``scatter`` before the clip.

    Within d_j of every surface D is smooth and the fit good to 1e-9 of S. Farther out than some d_j, D replaces the
    wing of that surface, which ends at its horizon, but for ripples of the clip that no Gaussian holds; they are left.
    Where they are all there is, the error told is 1 or more.
    """
    rough = tuple(s for s in surfaces if any(term.sigma > 0.0 for term in s.psd))
    distance = np.array([telescope.magnified_distance(s.marginal_height) for s in rough])
    nearest = min(reach, 0.1 * float(distance.min()))
    radius = np.concatenate([[0.0], nearest * np.linspace(0.1, 1.0, 32), np.geomspace(nearest, reach, 128)[1:]])
    density = scatter.density(radius)
    q, power = _clipped_power(rough, telescope, wavelength, reach)
    loss = special.j0(2.0 * math.pi * np.outer(radius, q)) @ power
    narrowest = 1.0 / (2.0 * math.pi * q[-1])
    widths = narrowest * np.geomspace(0.5, max(4.0, 2.0 * reach / narrowest), _gaussians(reach / narrowest))
    basis = np.exp(-0.5 * np.divide.outer(radius, widths) ** 2)
    true = np.maximum(density - loss, _VANISHED * density)  # what the error is relative to
    scale = true * np.maximum(radius / distance.max(), 1.0) ** _FADING
    height = np.linalg.lstsq(basis / scale[:, None], loss / scale, rcond=1e-13)[0]
    left = np.abs(basis @ height - loss)
    return HorizonLoss(
        GaussianMixture(2.0 * math.pi * widths**2 * height, widths**2),
        radius,
        np.where(density - loss > _VANISHED * density, left / true, np.maximum(left / true, 1.0)),
        float(np.trapezoid(2.0 * math.pi * radius * left, radius)),
    )


@lru_cache(maxsize=1)  # one mixture asks for what the finer one that judges it has asked for
def _clipped_power(
    surfaces: tuple[Surface, ...], telescope: Telescope, wavelength: float, reach: float
) -> tuple[Real, Real]:
    """Nodes q [cycles/mm] and 2 pi q [unclipped - clipped] dq there, not to be written to."""
    distance = np.array([telescope.magnified_distance(s.marginal_height) for s in surfaces])
    clip = _clips(surfaces, telescope, wavelength)
    q, dq = _panels(np.unique(clip[clip > 0.0]), reach)
    exponents = np.array(
        [transfer_exponent(wavelength * d * q, s, wavelength) for s, d in zip(surfaces, distance, strict=True)]
    )
    # unclipped - clipped, to full relative accuracy however little lies beyond the horizons
    excess = np.exp(np.minimum(exponents, 0.0).sum(axis=0)) * np.expm1(np.maximum(exponents, 0.0).sum(axis=0))
    return q, 2.0 * math.pi * q * excess * dq


def _gaussians(span: float) -> int:
    """How many Gaussians the fit takes: a few within the horizon, five per factor e beyond."""
    return 8 + 5 * math.ceil(math.log(max(span, 1.0)))


def _clips(surfaces: Sequence[Surface], telescope: Telescope, wavelength: float) -> Real:
    """The image-plane frequency q [cycles/mm] below which each surface's exponent is positive."""
    distance = np.array([telescope.magnified_distance(s.marginal_height) for s in surfaces])
    return np.array([_clip_separation(s, wavelength) for s in surfaces]) / (wavelength * distance)


@lru_cache(maxsize=64)  # the plan asks for it, and so do both mixtures of a wavelength
def _clip_separation(surface: Surface, wavelength: float) -> float:
    """The separation r [mm] below which the exponent K^2 C(r) - g is positive; 0 where no roughness lies beyond."""
    low, high = 1e-9 * wavelength, 10.0 * wavelength
    for _ in range(3):
        r = np.geomspace(low, high, 48)
        positive = transfer_exponent(r, surface, wavelength) > 0.0
        last = int(np.count_nonzero(positive)) - 1
        if last < 0:
            return 0.0
        low, high = float(r[last]), float(r[min(last + 1, r.size - 1)])
    return low


def _panels(breaks: Real, reach: float) -> tuple[Real, Real]:
    """Gauss nodes and weights from 0 through the ``breaks``; the first panel resolves the branch point at q = 0."""
    count = 48 + math.ceil(4.0 * min(reach * float(breaks.max(initial=0.0)), _MOST_RIPPLES))
    x, w = gauss_panels(count)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    nodes, weights = [], []
    start = 0.0
    for stop in breaks:
        # q = start + width t^4 makes q^(1 + 2 nu) smooth enough for any nu > 0
        width = stop - start
        nodes.append(start + width * x**4)
        weights.append(width * 4.0 * x**3 * w)
        start = stop
    return np.concatenate(nodes or [np.zeros(1)]), np.concatenate(weights or [np.zeros(1)])
