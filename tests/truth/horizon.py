"""What the clip at the horizon takes away: S = S_unclipped - D.

Near q = 0 the unclipped exponent E_j = K^2 C - g is positive (light beyond 90 degrees); H is held at 1 there. The
difference is confined to q < q_c ~ 1/d, so with doubles alone

    D(x) = 2 pi Int_0^qc q J0(2 pi q x) [exp(sum_j E_j) - exp(sum_j min(0, E_j))] dq.

Relative to S it grows as (x/d)^(C+1).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0

if TYPE_CHECKING:
    from .system import TruthSystem


def clip_frequencies(wavelength: float, surfaces: tuple) -> list[float]:
    """The frequencies q_c,j [cycles/mm] below which a surface is clipped: the roots of K^2 C(lambda d q) = g.

    None for a surface whose share beyond the horizon is below 1e-200 (steep spectra).
    """
    from .scatter import surface_exponent

    found = []
    for s in surfaces:

        def exponent(log_q: float, s: tuple = s) -> float:
            return float(surface_exponent(wavelength, s, np.array([math.exp(log_q)]))[0])

        guess = math.log(1.0 / s.d)
        if exponent(guess - 250.0) > 1e-200:
            found.append(math.exp(brentq(exponent, guess - 250.0, guess + 20.0, xtol=1e-14, rtol=1e-14)))
    return found


@lru_cache(maxsize=32)
def _quadrature(wavelength: float, surfaces: tuple) -> tuple[np.ndarray, np.ndarray]:
    """(q, 2 pi q w [unclipped - clipped]): Gauss panels, broken at the clips and graded towards q = 0."""
    from .scatter import surface_exponent

    clips = sorted(clip_frequencies(wavelength, surfaces))
    if not clips:
        return np.zeros(1), np.zeros(1)
    first = min(clips[0], clips[-1] / 24.0)
    edges = np.unique([*clips, *np.linspace(first, clips[-1], 25), *(first * 0.5 ** np.arange(1, 30)), 0.0])
    x, w = np.polynomial.legendre.leggauss(14)
    half = 0.5 * np.diff(edges)[:, None]
    q = (edges[:-1, None] + half + half * x).ravel()
    exponents = [surface_exponent(wavelength, s, q) for s in surfaces]
    clipped = sum(np.minimum(0.0, e) for e in exponents)
    excess = np.exp(clipped) * np.expm1(sum(np.maximum(0.0, e) for e in exponents))
    return q, 2.0 * np.pi * q * (half * w).ravel() * excess


def missing_psf(system: TruthSystem, x: np.ndarray) -> np.ndarray:
    """D(x) [1/mm^2] at radii ``x`` [mm] of any shape (x < 30 d). With S: 1e-6 of FFTLog up to 0.8 d."""
    x = np.asarray(x, float)
    q, weight = _quadrature(system.wavelength, system.surfaces)
    flat = x.ravel()
    parts = [j0(2.0 * np.pi * np.outer(flat[i : i + 4096], q)) @ weight for i in range(0, flat.size, 4096)]
    return np.concatenate(parts).reshape(x.shape) if parts else np.zeros_like(x)


def missing_in_rectangle(
    system: TruthSystem, window: tuple[float, float, float, float], x: np.ndarray, y: np.ndarray, weight: np.ndarray
) -> float:
    """Energy of D, centred on each of the points ``x``, ``y`` [mm] of given ``weight``, in (x0, x1, y0, y1) [mm].

    A product Gauss rule over the rectangle; D varies on the scale of d, which no spot approaches. Windows up to a few
    d.
    """
    if not system.surfaces:
        return 0.0
    x0, x1, y0, y1 = window
    shortest = min(s.d for s in system.surfaces)
    nodes, gauss = np.polynomial.legendre.leggauss(10 + int(8.0 * max(x1 - x0, y1 - y0) / shortest))
    px = 0.5 * (x1 + x0 + (x1 - x0) * nodes)
    py = 0.5 * (y1 + y0 + (y1 - y0) * nodes)
    radius = np.hypot(px[None, :, None] - x, py[:, None, None] - y)
    average = np.einsum("i,j,ijk,k->", gauss, gauss, missing_psf(system, radius), weight) / 4.0
    return float(average * (x1 - x0) * (y1 - y0))
