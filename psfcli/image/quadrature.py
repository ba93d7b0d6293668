"""Quadrature: Gauss's rule, and adaptive integration of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

_LARGEST_PANEL = 64
_MOST_NODES = 400_000
_SLICES_AT_ONCE = 256
_LEAST_SHARE = 0.1  # few slices hold a kink of any one function: each may use this share of the tolerance
_KINK_GAIN = 2.0  # from a slice to its halves a kink's error falls by 2^(3/2) to 4


@lru_cache(maxsize=256)
def gauss_legendre(count: int) -> tuple[Real, Real]:
    """Nodes and weights of Gauss's rule on (-1, 1), shape (count,), not to be written to; weights add to 2."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight


def gauss_panels(count: int) -> tuple[Real, Real]:
    """Nodes and weights on (-1, 1), at least ``count``, of Gauss's rule on as many equal panels as keep each small."""
    panels = 1 + (count - 1) // _LARGEST_PANEL
    node, weight = gauss_legendre(-(-count // panels))
    start = -1.0 + 2.0 * np.arange(panels)[:, None] / panels
    return (start + (node + 1.0) / panels).ravel(), np.tile(weight / panels, panels)


@dataclass(frozen=True, slots=True)
class Rule:
    """A quadrature rule, ``node`` and ``weight`` of one shape, the ``integral`` of each function it was made for, and

    the estimated ``error`` of the worst.
    """

    node: Real
    weight: Real
    integral: Real
    error: float


def integrate_adaptively(functions: Callable[[Real], Real], left: Real, right: Real, tolerance: float) -> Rule:
    """A rule for the integral of ``functions`` over slices from ``left`` to ``right``, within ``tolerance`` for each.

    Slices are judged one by one, and many small errors may add up to a large one: then all is done again, more
    strictly. The rule's error exceeds the tolerance only where it would take more than a reasonable number of nodes.
    """
    strictness = 1.0
    while True:
        rule = _halved_until(functions, left, right, tolerance / strictness)
        if rule.error <= tolerance or rule.node.size > _MOST_NODES:
            return rule
        strictness *= 2.0 * max(2.0, rule.error / tolerance)


def _halved_until(functions: Callable[[Real], Real], left: Real, right: Real, tolerance: float) -> Rule:
    """A rule made by halving slices until each is within its share of ``tolerance``.

    Each slice is integrated by Simpson's rule and by that on its halves: closed rules, so that a kink always lies
    between two points that were seen. The error is the sum of the changes over all slices, for the worst function,
    less what the last halving gained.
    """
    whole = float(np.sum(right - left))
    nodes: list[Real] = []
    weights: list[Real] = []
    integral = doubt = np.zeros(1)
    count = 0
    for first in range(0, left.size, _SLICES_AT_ONCE):  # a few slices at a time, to the end: little is held
        a, b = left[first : first + _SLICES_AT_ONCE], right[first : first + _SLICES_AT_ONCE]
        point, where = np.unique(np.concatenate([a, 0.5 * (a + b), b]), return_inverse=True)
        fa, fm, fb = np.split(functions(point)[where], 3)
        count += point.size
        while a.size:
            middle = 0.5 * (a + b)
            fl, fr = np.split(functions(np.concatenate([0.5 * (a + middle), 0.5 * (middle + b)])), 2)
            count += 2 * a.size
            twelfth = ((b - a) / 12.0)[:, None]
            change = np.abs(twelfth * (4.0 * (fl + fr) - fa - fb - 6.0 * fm))
            done = change.max(axis=1) <= tolerance * np.maximum((b - a) / whole, _LEAST_SHARE)
            done |= count > _MOST_NODES
            doubt = doubt + change[done].sum(axis=0)
            integral = integral + (twelfth * (fa + 4.0 * (fl + fr) + 2.0 * fm + fb))[done].sum(axis=0)
            for place, weight in ((0.0, 1.0), (0.25, 4.0), (0.5, 2.0), (0.75, 4.0), (1.0, 1.0)):
                nodes.append((a + place * (b - a))[done])
                weights.append((weight / 12.0 * (b - a))[done])
            more = ~done
            a, b = np.concatenate([a[more], middle[more]]), np.concatenate([middle[more], b[more]])
            fa, fm, fb = (
                np.concatenate([fa[more], fm[more]]),
                np.concatenate([fl[more], fr[more]]),
                np.concatenate([fm[more], fb[more]]),
            )
    return Rule(np.concatenate(nodes), np.concatenate(weights), integral, float(doubt.max(initial=0.0)) / _KINK_GAIN)
