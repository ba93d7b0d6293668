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
from psfcli.surface.harvey_shack import transfer_exponent
from psfcli.surface.mixture import GaussianMixture
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope

Real = NDArray[np.float64]

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


def horizon_loss(
    surfaces: Sequence[Surface],
    telescope: Telescope,
    wavelength: float,
    scatter: GaussianMixture,
    reach: float,
    share: float,
) -> HorizonLoss:
    """D(r) for r <= ``reach`` [mm]; no Gaussians where it is below ``share`` of the ``scatter`` it is taken from.

    Within d_j of every surface D is smooth and the fit good to 1e-9 of S. Farther out than some d_j, D replaces the
    wing of that surface, which ends at its horizon, but for ripples of the clip that no Gaussian holds; they are left.
    """
    rough = tuple(s for s in surfaces if any(term.sigma > 0.0 for term in s.psd))
    nearest = min(reach, 0.1 * min(telescope.magnified_distance(s.marginal_height) for s in rough))
    radius = np.concatenate([[0.0], nearest * np.linspace(0.1, 1.0, 32), np.geomspace(nearest, reach, 128)[1:]])
    density = scatter.density(radius)
    q, power = _clipped_power(rough, telescope, wavelength, reach)
    if power.sum() <= share * density[-1]:
        return HorizonLoss(GaussianMixture(np.empty(0), np.empty(0)), radius, np.zeros_like(radius), 0.0)
    loss = special.j0(2.0 * math.pi * np.outer(radius, q)) @ power
    narrowest = 1.0 / (2.0 * math.pi * q[-1])
    widths = narrowest * np.geomspace(0.5, max(4.0, 2.0 * reach / narrowest), _gaussians(reach / narrowest))
    basis = np.exp(-0.5 * np.divide.outer(radius, widths) ** 2)
    true = np.maximum(density - loss, 1e-3 * density)  # what the error is relative to
    height = np.linalg.lstsq(basis / true[:, None], loss / true, rcond=1e-13)[0]
    left = np.abs(basis @ height - loss)
    return HorizonLoss(
        GaussianMixture(2.0 * math.pi * widths**2 * height, widths**2),
        radius,
        left / true,
        float(np.trapezoid(2.0 * math.pi * radius * left, radius)),
    )


@lru_cache(maxsize=1)  # one mixture asks for what the finer one that judges it has asked for
def _clipped_power(
    surfaces: tuple[Surface, ...], telescope: Telescope, wavelength: float, reach: float
) -> tuple[Real, Real]:
    """Nodes q [cycles/mm] and 2 pi q [unclipped - clipped] dq there, not to be written to."""
    distance = np.array([telescope.magnified_distance(s.marginal_height) for s in surfaces])
    separation = np.array([_clip_separation(s, wavelength) for s in surfaces])
    clip = separation / (wavelength * distance)  # q below which each surface's exponent is positive
    q, dq = _panels(np.unique(clip[clip > 0.0]), reach)
    exponents = np.array(
        [transfer_exponent(wavelength * d * q, s, wavelength) for s, d in zip(surfaces, distance, strict=True)]
    )
    excess = np.exp(exponents.sum(axis=0)) - np.exp(np.minimum(exponents, 0.0).sum(axis=0))
    return q, 2.0 * math.pi * q * excess * dq


def _gaussians(span: float) -> int:
    """How many Gaussians the fit takes: a few within the horizon, five per factor e beyond."""
    return 8 + 5 * math.ceil(math.log(max(span, 1.0)))


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
