"""The unclipped S(r) on the real axis: panels between the zeros of J0, their alternating sums accelerated (Levin's u).

Nothing of ``contour`` but the transfer function is used here; no complex plane, no logarithmic rule.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import mpmath

from .contour import unclipped_exponent, unclipped_height

if TYPE_CHECKING:
    from .system import TruthSystem


def scatter_psf_panels(system: TruthSystem, r: float, dps: int = 40, nodes: int = 24, panels: int = 45) -> mpmath.mpf:
    """Unclipped S(r) = 2 pi Int q J0(2 pi q r) h(q) dq [1/mm^2], for r above about lambda d/B.

    The first panel holds the branch point q^(C-1) and is done by tanh-sinh, the others by Gauss rules. Reliable to
    1e-10 relative where ``dps`` exceeds (C + 1) decades + 25 and the panels are many enough: compare two values of
    each.
    """
    with mpmath.workdps(dps):
        wavelength, surfaces = system.wavelength, system.surfaces
        height = unclipped_height(wavelength, surfaces)
        # a constant has no transform away from r = 0: h may be replaced by the OTF less its limit
        limit = height * mpmath.exp(-mpmath.fsum((mpmath.mpf(s.K) * t.sigma) ** 2 for s in surfaces for t in s.terms))
        scale = 2 * mpmath.pi * mpmath.mpf(r)

        def integrand(z: mpmath.mpf) -> mpmath.mpf:
            h = height * mpmath.exp(unclipped_exponent(wavelength, surfaces, z / scale)) - limit
            return z * mpmath.besselj(0, z) * h

        zeros = [mpmath.mpf(0)] + [mpmath.besseljzero(0, n) for n in range(1, panels + 1)]
        gauss = _gauss_legendre(nodes)
        total = mpmath.quad(integrand, zeros[:2], method="tanh-sinh", maxdegree=8)
        levin = mpmath.levin(method="levin", variant="u")
        sums = [total]
        for a, b in itertools.pairwise(zeros[1:]):
            half, middle = (b - a) / 2, (b + a) / 2
            total += half * mpmath.fsum(w * integrand(middle + half * x) for x, w in gauss)
            sums.append(total)
        value, _ = levin.update_psum(sums)
        return value * 2 * mpmath.pi / scale**2


def _gauss_legendre(n: int) -> list[tuple[mpmath.mpf, mpmath.mpf]]:
    """Nodes and weights of the n-point Gauss-Legendre rule at the working precision, by Newton's method."""
    rule = []
    for i in range(1, n + 1):
        x = mpmath.cos(mpmath.pi * (i - mpmath.mpf(1) / 4) / (n + mpmath.mpf(1) / 2))
        for _ in range(8):
            p, before = mpmath.mpf(1), mpmath.mpf(0)
            for k in range(1, n + 1):
                p, before = ((2 * k - 1) * x * p - (k - 1) * before) / k, p
            slope = n * (before - x * p) / (1 - x * x)
            x -= p / slope
        rule.append((x, 2 / ((1 - x * x) * slope**2)))
    return rule
