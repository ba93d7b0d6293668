"""The logarithm of a sum of K-correlations, one- or two-dimensional, and its derivatives.

Terms are rows of ln A, ln B and C: A [mm^3] the one-sided 1-D spectrum at f = 0, B [mm] the knee's length, C the slope.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.metrology.measurement import KINDS, TWO_DIMENSIONAL, TWO_SIDED
from psfcli.surface.psd import KCorrelation

Real = NDArray[np.float64]

PER_TERM = 3
"""Parameters of a term."""


def log_density(frequency: Real, kind: NDArray[np.intp], terms: Real) -> tuple[Real, Real]:
    """Ln S at each ``frequency`` [cycles/mm], and its derivatives by the parameters.

    One-sided S1 = sum_j A_j/[1 + (B_j f)^2]^(C_j/2), two-sided S1/2, in two dimensions S2 = sum_j K_j A_j B_j/[1 +
    (B_j f)^2]^((C_j+1)/2) with K = Gamma((C+1)/2)/(2 sqrt(pi) Gamma(C/2)). ``kind`` [n] counts in KINDS, ``terms`` is
    [term, 3]; the answers are [n] (densities in mm^3 or mm^4) and [n, 3 term]. Valid for B f below 1e150.
    """
    plane = (kind == KINDS.index(TWO_DIMENSIONAL)).astype(np.float64)
    each, slopes = [], []
    for ln_A, ln_B, C in terms:
        u = (frequency * math.exp(ln_B)) ** 2
        fall, beyond = np.log1p(u), u / (1.0 + u)
        ln_K = special.gammaln((C + 1.0) / 2.0) - special.gammaln(C / 2.0) - math.log(2.0 * math.sqrt(math.pi))
        by_C = 0.5 * (special.digamma((C + 1.0) / 2.0) - special.digamma(C / 2.0))
        each.append(ln_A + plane * (ln_K + ln_B) - 0.5 * (C + plane) * fall)
        slopes.append(np.stack([np.ones_like(u), plane - (C + plane) * beyond, plane * by_C - 0.5 * fall], axis=-1))
    total = np.logaddexp.reduce(each, axis=0)
    shares = [np.exp(one - total)[:, None] * slope for one, slope in zip(each, slopes, strict=True)]
    return total - math.log(2.0) * (kind == KINDS.index(TWO_SIDED)), np.concatenate(shares, axis=-1)


def k_correlations(terms: Real) -> tuple[KCorrelation, ...]:
    """The terms [term, 3] as spectra of a surface."""
    return tuple(KCorrelation.from_A(math.exp(ln_A), math.exp(ln_B), float(C)) for ln_A, ln_B, C in terms)
