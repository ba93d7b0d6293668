"""The energy of S about rays in a rectangle, each ray by the method that keeps its relative accuracy.

By where the ray is (c: narrowest knee, gap: distance to the rectangle):

- rectangle small against hypot(gap, c): a product Gauss rule of S;
- ray inside, or no farther outside than c/2: (1/2 pi) closed Int [energy within R] dphi along the edges;
- ray outside: - (1/2 pi) closed Int [energy beyond R] dphi, and where that cancels, the rectangle in quarters.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .radial import RadialScatter

Window = tuple[float, float, float, float]

_TABLE = 1e-12  # relative error of the tabled energies
_CANCELLED = 1e-10  # the most of it that may be left in what a ray outside sees
# S is singular at r = i c, the more the steeper it falls: both rules keep 1e-9 of the energy up to C = 8
_EDGE_PIECE, _EDGE_RULE = 1.0, np.polynomial.legendre.leggauss(12)
# (longest side over hypot(gap, c), Gauss nodes along it)
_RULES = (0.02, 3), (0.08, 4), (0.2, 6), (0.5, 8)
_PRODUCT_RULES = tuple((side, np.polynomial.legendre.leggauss(nodes)) for side, nodes in _RULES)


def energy_about(
    halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray, absolute: float = 0.0
) -> np.ndarray:
    """The energy of S about each ray (x, y) [mm] in the window, to 1e-10 of it or ``absolute``."""
    x0, x1, y0, y1 = window
    gap = np.hypot(np.maximum(0.0, np.maximum(x0 - x, x - x1)), np.maximum(0.0, np.maximum(y0 - y, y - y1)))
    scale = np.hypot(gap, halo.core)
    side = max(x1 - x0, y1 - y0) / scale
    result = np.empty_like(x)
    least = 0.0
    for most, rule in _PRODUCT_RULES:
        if (some := (side >= least) & (side < most)).any():
            result[some] = _product_rule(halo, window, x[some], y[some], *rule)
        least = most
    away = (side >= least) & (gap > 0.5 * halo.core)
    near = (side >= least) & ~away
    if near.any():
        result[near] = along_edges(halo.inside, window, x[near], y[near], 0.3 * scale[near])
    if away.any():
        result[away] = -along_edges(halo.outside, window, x[away], y[away], gap[away])
        lost = np.zeros_like(away)
        error = _TABLE * halo.outside(gap[away] ** 2)
        lost[away] = error > np.maximum(_CANCELLED * np.abs(result[away]), absolute)
        if lost.any():
            result[lost] = sum(energy_about(halo, part, x[lost], y[lost], absolute) for part in _in_quarters(window))
    return result


def scales_about(halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Over what distance in x, and in y, the energy about the ray (x, y) varies [mm].

    Across the line of an edge it varies like S integrated along the edge, which is singular at the imaginary distance
    i hypot(c, distance along the line to the edge).
    """
    x0, x1, y0, y1 = window
    beside, above = (np.maximum(0.0, np.maximum(a - v, v - b)) for v, a, b in ((x, x0, x1), (y, y0, y1)))
    to_x, to_y = (np.minimum(np.abs(v - a), np.abs(v - b)) for v, a, b in ((x, x0, x1), (y, y0, y1)))
    return np.sqrt(halo.core**2 + to_x**2 + above**2), np.sqrt(halo.core**2 + to_y**2 + beside**2)


def _product_rule(
    halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray, node: np.ndarray, gauss: np.ndarray
) -> np.ndarray:
    x0, x1, y0, y1 = window
    dx = (0.5 * (x1 + x0 + (x1 - x0) * node)[:, None] - x) ** 2
    dy = (0.5 * (y1 + y0 + (y1 - y0) * node)[:, None] - y) ** 2
    total = np.zeros_like(x)
    for weight, square in zip(gauss, dy, strict=True):
        total += weight * (gauss @ halo.psf(dx + square))
    return total * (x1 - x0) * (y1 - y0) / 4.0


def _in_quarters(window: Window) -> list[Window]:
    x0, x1, y0, y1 = window
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    return [(x0, x, y0, y), (x, x1, y0, y), (x0, x, y, y1), (x, x1, y, y1)]


def along_edges(
    energy: Callable[[np.ndarray], np.ndarray], window: Window, x: np.ndarray, y: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """(1/2 pi) closed Int ``energy`` (R^2) dphi seen from each (x, y), smooth on ``scale`` about it.

    Each edge in pieces of v, place along it = b sinh v with b what keeps energy/R^2, R^2 = a^2 + place^2, smooth; as
    many pieces as the ray needs.
    """
    x0, x1, y0, y1 = window
    a = np.concatenate([x1 - x, x - x0, y1 - y, y - y0])
    low, high = (np.concatenate([v, v, u, u]) for v, u in ((y0 - y, x0 - x), (y1 - y, x1 - x)))
    b = np.hypot(a, np.tile(scale, 4))
    v0, v1 = np.arcsinh(low / b), np.arcsinh(high / b)
    pieces = np.maximum(1, np.ceil((v1 - v0) / _EDGE_PIECE)).astype(np.intp)
    half = 0.5 * (v1 - v0) / pieces
    owner = np.repeat(np.arange(len(a)), pieces)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    node, gauss = _EDGE_RULE
    a, b, half = a[owner], b[owner], half[owner]
    growth = np.exp(v0[owner] + (2 * number + 1) * half + half * node[:, None])  # [node, piece]
    fall = 1.0 / growth
    square = a * a + (0.5 * b * (growth - fall)) ** 2
    seen = (growth + fall) / square  # dphi/dv but for a b/2
    found = 0.5 * a * b * half * (gauss @ (energy(square) * seen))
    return np.bincount(owner % len(x), found, len(x)) / (2.0 * math.pi)
