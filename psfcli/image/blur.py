"""Gaussians blurred by the spot: N (x) PSF_G by moments where the Gaussian is wide, by rays where it is narrow [mm].

A Gaussian of variance s^2 much wider than the spot sees only the first moments of PSF_G. With the centroid and the
variances sigma_x^2, sigma_y^2 taken into the Gaussian itself, the rest is a Gram-Charlier series,

    N (x) PSF_G = sum_ab Q_ab (-d/dx)^a (-d/dy)^b N(x - cx; s^2 + sigma_x^2) N(y - cy; s^2 + sigma_y^2),
    Q_ab = E[He_a(eps_x; sigma_x^2) He_b(eps_y; sigma_y^2)]/(a! b!),

Q_00 = 1 and no terms of first order, none of second but Q_11: products of one-dimensional functions, so a whole
window is a product of two matrices. A narrow Gaussian is summed over rays no farther apart than its own width, where
the trapezoid rule in the pupil errs by 2 exp(-2 pi^2 s^2/spacing^2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.image.geometric import MAX_MOMENT, GeometricalImage
from psfcli.image.quadrature import gauss_legendre, gauss_rule
from psfcli.surface.mixture import GaussianMixture
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]
Index = NDArray[np.intp]

MAX_ORDER = MAX_MOMENT - 2  # the moments beyond tell the error
TAIL = 8.5  # widths beyond which less than 1e-17 of a Gaussian lies
_HERMITE_MARGIN = (
    10.0  # |He_a(u)| <= 1.09 sqrt(a!) exp(u^2/4): the factor at u = 3, where a mixture's terms still count
)
_SHARE = 0.3  # of the tolerance, for all terms together
_SMOOTH_CELL = 0.25  # cells narrower than this many widths: Gauss's rule instead of differences (relative error 2e-8)
FEW_TERMS, FEWER_TERMS = 8, 5  # fewer are wider, and less exact
_NODE, _NODE_WEIGHT = gauss_legendre(4)


def truncation_error(image: GeometricalImage, variance: Real) -> Real:
    """Relative error of cutting the series after total order 0, 1, ... MAX_ORDER, shape (order, term).

    The sum of the bounds of all later known orders. ``variance`` is s^2 of each term [mm^2].
    """
    order = np.arange(MAX_MOMENT + 1)
    root = np.sqrt(special.factorial(order))
    width_x, width_y = np.sqrt(variance + image.spot.rms_x**2), np.sqrt(variance + image.spot.rms_y**2)
    a, b = np.nonzero(image.moments)
    scaled_x, scaled_y = (root[n, None] / width ** n[:, None] for n, width in ((a, width_x), (b, width_y)))
    known = np.abs(image.moments[a, b])[:, None] * scaled_x * scaled_y
    size = (order[:, None] == a + b).astype(np.float64) @ known
    later = np.cumsum(size[::-1], axis=0)[::-1]
    return _HERMITE_MARGIN * later[1 : MAX_ORDER + 2]


def moment_orders(image: GeometricalImage, mixture: GaussianMixture, tolerance: Tolerance) -> Index:
    """The lowest order of moments that blurs each term within ``tolerance``, or -1 where none does, shape (term,).

    Within a share of ``tolerance.pixel`` relative and, all terms together, of ``tolerance.ee`` of all light.
    """
    if mixture.weight.size == 0:
        return np.zeros(0, dtype=np.intp)
    energy = _SHARE * tolerance.ee / mixture.weight.size
    allowed = np.minimum(0.1 * tolerance.pixel, energy / np.abs(mixture.weight))
    enough = truncation_error(image, mixture.variance) <= allowed
    return np.where(enough.any(axis=0), enough.argmax(axis=0), -1)


def moments_to(image: GeometricalImage, order: int) -> Real:
    """Q_ab for a + b <= ``order``, zero beyond, shape (order + 1,) * 2 [mm^(a+b)]."""
    ranks = np.arange(order + 1)
    return np.where(np.add.outer(ranks, ranks) > order, 0.0, image.moments[: order + 1, : order + 1])


def ray_spacing(width: Real, error: Real) -> Real:
    """The ray spacing [mm], at most 4.4 widths, at which Gaussians of ``width`` [mm] err by ``error``, relative."""
    return width * math.pi * np.sqrt(2.0 / np.log(np.maximum(2.0 / error, math.e)))


def ray_error(width: Real, spacing: Real) -> Real:
    """The relative error of Gaussians of ``width`` summed over rays ``spacing`` apart; ray_spacing is its inverse."""
    error: Real = 2.0 * np.exp(-2.0 * (math.pi * width / spacing) ** 2)
    return error


def fewer_terms(mixture: GaussianMixture, count: int = FEW_TERMS, power: float = 0.25) -> GaussianMixture:
    """Terms that do to an image what all do: Gauss's rule in u = width^``power``, exact for u^0 to u^(2 ``count`` - 1).

    What lies about an edge is no power series of the width where it is as wide as caustics and corners are far away;
    measured, the fourth root is as good as the width itself for smooth images, and gains a digit or two at caustics.
    The larger the power, the wider the narrowest term.
    ``mixture`` by increasing variance, of positive weights.
    """
    if mixture.weight.size <= count:
        return mixture
    widest = mixture.variance[-1]
    node, weight = gauss_rule((mixture.variance / widest) ** (0.5 * power), mixture.weight, count)
    return GaussianMixture(weight, widest * node ** (2.0 / power))


def shares(mixture: GaussianMixture, r: Real) -> Real:
    """Each term's part of the mixture's light at distances ``r`` [mm], shape (r, term)."""
    with np.errstate(under="ignore"):
        light = np.abs(mixture.weight) / mixture.variance * np.exp(-0.5 * np.divide.outer(r**2, mixture.variance))
        part: Real = light / np.maximum(light.sum(axis=1), np.finfo(np.float64).tiny)[:, None]
    return part


def interval_integrals(start: Real, stop: Real, variance: Real, order: int) -> Real:
    """Int_start^stop (-d/dx)^a N(x; variance) dx for a = 0..order: shape (order + 1, term, cell) [mm^-a].

    ``start`` and ``stop`` [mm], relative to the Gaussian's centre, of shape (cell,) or (term, cell); ``variance`` of
    shape (term,). Full relative accuracy in the far tail and for cells much narrower than the Gaussian.
    """
    width = np.sqrt(variance)[:, None]
    low, high = start / width, stop / width
    out = np.empty((order + 1, *low.shape))
    smooth = np.max(high - low, axis=1, initial=0.0) < _SMOOTH_CELL
    if np.any(smooth):
        out[:, smooth] = _by_quadrature(low[smooth], high[smooth], order)
    if not np.all(smooth):
        out[:, ~smooth] = _by_difference(low[~smooth], high[~smooth], order)
    return out / width ** np.arange(order + 1)[:, None, None]


def normal_probability(low: Real, high: Real) -> Real:
    """The normal probability between ``low`` and ``high``, relative accuracy kept in both tails; their shape."""
    flip = low + high > 0.0
    probability: Real = special.ndtr(np.where(flip, -low, high)) - special.ndtr(np.where(flip, -high, low))
    return probability


def _by_difference(low: Real, high: Real, order: int) -> Real:
    out = np.empty((order + 1, *low.shape))
    out[0] = normal_probability(low, high)
    if order > 0:
        edge = np.stack([low, high])
        bell = np.exp(-0.5 * edge**2) / math.sqrt(2.0 * math.pi)
        previous, current = np.zeros_like(edge), bell
        for a in range(1, order + 1):
            out[a] = current[0] - current[1]
            previous, current = current, edge * current - (a - 1) * previous
    return out


def _by_quadrature(low: Real, high: Real, order: int) -> Real:
    out = np.zeros((order + 1, *low.shape))
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for node, weight in zip(_NODE, _NODE_WEIGHT, strict=True):
        u = middle + half * node
        previous, current = np.zeros_like(u), (weight / math.sqrt(2.0 * math.pi)) * half * np.exp(-0.5 * u**2)
        for a in range(order + 1):
            out[a] += current
            previous, current = current, u * current - a * previous
    return out
