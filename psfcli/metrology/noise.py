"""The scatter of measured spectra about their mean, in the logarithm.

A periodogram is exponentially distributed about the spectrum, the mean of m of them gamma distributed with shape m: its
logarithm has the variance psi'(m) and the mean ln S + psi(m) - ln m, below ln S. So the scatter alone tells the bias.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

Real = NDArray[np.float64]

LEAST_SCATTER = 1e-6
"""No measured spectrum scatters less; numbers without noise are taken to."""
_LEAST_AVERAGES = 0.5  # chi-square of one degree of freedom
_MOST_CORRELATION = 0.95
_NEWTON = 6  # steps; four reach rounding


def averages(scatter: Real) -> Real:
    """M with psi'(m) = ``scatter``^2: how many periodograms of one mode were averaged; not below one half.

    Newton's method on 1/psi', which is nearly linear in m; shape of ``scatter``.
    """
    variance = np.square(scatter)
    m = 1.0 / variance + 0.5
    for _ in range(_NEWTON):
        trigamma = special.polygamma(1, m)
        m = np.maximum(m + trigamma * (1.0 - trigamma / variance) / special.polygamma(2, m), _LEAST_AVERAGES)
    return m


def log_bias(scatter: Real) -> Real:
    """psi(m) - ln m [1]: the mean of the logarithm of a measured spectrum, less that of the spectrum; 0 or below.

    Shape of ``scatter``.
    """
    m = averages(scatter)
    bias: Real = special.digamma(m) - np.log(m)
    return bias


def points_per_independent(residuals: Real) -> float:
    """How many neighbours count as one independent point: (1 + r)/(1 - r), r the correlation of neighbours.

    As of a first-order autoregression. Windows and smoothing correlate neighbours, and so does a fit of the wrong form.
    1 where r is below 2/sqrt(n), within chance; ``residuals`` [n] rise with frequency.
    """
    power = float(np.sum(residuals**2))
    r = float(np.sum(residuals[1:] * residuals[:-1])) / power if power > 0.0 else 0.0
    if r < 2.0 / math.sqrt(residuals.size):
        return 1.0
    r = min(r, _MOST_CORRELATION)
    return (1.0 + r) / (1.0 - r)
