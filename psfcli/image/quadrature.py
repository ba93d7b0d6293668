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

    ``functions`` maps points (n,) to values (n, functions). Each slice is integrated by Simpson's rule and by that
    on its halves: closed rules, so that a kink always lies between two points that were seen. The error is the sum
    of the changes over all slices, for the worst function, less what the last halving gained.
    """
    whole = float(np.sum(right - left))
    value_left, value_middle, value_right = np.split(functions(np.concatenate([left, 0.5 * (left + right), right])), 3)
    integral, doubt = np.zeros(value_left.shape[1]), np.zeros(value_left.shape[1])
    nodes, weights = [], []
    count = 3 * left.size
    while left.size:
        ends = []
        for first in range(0, left.size, _SLICES_AT_ONCE):
            part = slice(first, first + _SLICES_AT_ONCE)
            a, b = left[part], right[part]
            fa, fm, fb = value_left[part], value_middle[part], value_right[part]
            middle = 0.5 * (a + b)
            fl, fr = np.split(functions(np.concatenate([0.5 * (a + middle), 0.5 * (middle + b)])), 2)
            twelfth = ((b - a) / 12.0)[:, None]
            change = np.abs(twelfth * (4.0 * (fl + fr) - fa - fb - 6.0 * fm))
            share = np.maximum((b - a) / whole, _LEAST_SHARE)
            done = change.max(axis=1) <= tolerance * share
            if count > _MOST_NODES:
                done[:] = True
            doubt += change[done].sum(axis=0)
            integral += (twelfth * (fa + 4.0 * (fl + fr) + 2.0 * fm + fb))[done].sum(axis=0)
            for place, weight in ((0.0, 1.0), (0.25, 4.0), (0.5, 2.0), (0.75, 4.0), (1.0, 1.0)):
                nodes.append((a + place * (b - a))[done])
                weights.append((weight / 12.0 * (b - a))[done])
            more = ~done
            ends.append((a[more], middle[more], fa[more], fl[more], fm[more]))
            ends.append((middle[more], b[more], fm[more], fr[more], fb[more]))
            count += 2 * int(np.count_nonzero(more))
        left, right, value_left, value_middle, value_right = (
            np.concatenate(column) for column in zip(*ends, strict=True)
        )
    return Rule(np.concatenate(nodes), np.concatenate(weights), integral, float(doubt.max(initial=0.0)) / _KINK_GAIN)
