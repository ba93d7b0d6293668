"""The unscattered light in a rectangle: the lit fraction of each ring of the pupil (``rings``), over rho^2.

Rings that may land in the rectangle are found first, then the kinks of the fraction among them, where the way a ring
passes the rectangle's edges changes. Between kinks a substitution takes the square roots off both ends, and panels are
halved until they stand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .rings import harmonics, landing

if TYPE_CHECKING:
    from .system import TruthSystem

# Clenshaw-Curtis, exact to degree 12: its nodes include the ends, where a kink would hide from a Gauss rule
_NODES = np.cos(np.pi * np.arange(13) / 12.0)
_WEIGHTS = np.linalg.solve(np.polynomial.legendre.legvander(_NODES, 12).T, np.eye(13)[0] * 2.0)

_RINGS = 97  # among which kinks are looked for, in each interval
_PARTS, _ROUNDS = 8, 9  # of a search: 1e-8 of what it begins with
_MOST_INTERVALS = 500
_TWICE = np.array([1.0, 2.0, 2.0])  # on a ring no ray error is beyond |c_0| + 2 |c_1| + 2 |c_2|


def rings_that_may_land(system: TruthSystem, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Intervals of rho, shape [n, 2], outside which no ray lands in the rectangle [mm].

    Intervals are halved, and those are kept whose middle ring has rays in the rectangle widened by the farthest a ray
    moves between that ring and the interval's ends. Until that is no more than the rectangle's own width (or
    ``_MOST_INTERVALS`` are kept: a slender rectangle across the spot takes light from nearly every ring). Only rho is
    divided, for which azimuths of a ring land is known exactly: a ring that focuses to a point is found like any other.
    """
    inner, width_x, width_y = system.obscuration, x1 - x0, y1 - y0
    rho = np.linspace(0.0, 1.0, 33)  # of any pupil, be it as thin as rounding
    bends = np.abs(np.diff(harmonics(system, rho), 2, axis=1)).max(axis=1) / rho[1] ** 2
    bend_x, bend_y = 1.2 * bends @ _TWICE
    edges = np.linspace(inner, 1.0, 17)
    intervals = np.stack([edges[:-1], edges[1:]], axis=1)
    for _ in range(48):
        low, high = intervals.T
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        # over half an interval: by the slopes between its ends, and the greatest second derivatives anywhere
        moved_x, moved_y = 0.5 * np.abs(harmonics(system, high) - harmonics(system, low)) @ _TWICE
        moved_x, moved_y = moved_x + bend_x * half**2, moved_y + bend_y * half**2
        fraction, _ = landing(system, middle, x0 - moved_x, x1 + moved_x, y0 - moved_y, y1 + moved_y)
        near = fraction > 0.0
        intervals, middle = intervals[near], middle[near]
        small = np.all((moved_x[near] <= width_x) & (moved_y[near] <= width_y))
        if small or len(intervals) > _MOST_INTERVALS:
            break
        low, high = intervals.T
        intervals = np.concatenate([np.stack([low, middle], axis=1), np.stack([middle, high], axis=1)])
    return _joined(intervals)


def _joined(intervals: np.ndarray) -> np.ndarray:
    """The union of intervals [n, 2] as intervals that do not touch."""
    if len(intervals) == 0:
        return intervals
    low, high = intervals[np.argsort(intervals[:, 0])].T
    reach = np.maximum.accumulate(high)
    gap = np.append(True, low[1:] > reach[:-1] + 1e-15)
    return np.stack([low[gap], np.append(reach[:-1][gap[1:]], reach[-1])], axis=1)


def _kinks(system: TruthSystem, window: tuple[float, float, float, float], low: float, high: float) -> np.ndarray:
    """Where between ``low`` and ``high`` of rho^2 (both included) rings begin to pass the window's edges differently.

    Neighbours of a sample of rings that differ are searched between, part by part, for the first ring unlike the left
    one, and again from there on. What the sample misses is left to the halving of panels.
    """
    p = np.linspace(low**0.5, high**0.5, _RINGS) ** 2  # the smaller a ring, the less its light spreads
    _, way = landing(system, np.sqrt(p), *window)
    changed = np.any(way[1:] != way[:-1], axis=1)
    left, right, way_left, way_right = p[:-1][changed], p[1:][changed], way[:-1][changed], way[1:][changed]
    found = []
    while len(left):
        a, b, way_b = left, right, way_right
        for _ in range(_ROUNDS):
            grid = a[:, None] + (b - a)[:, None] * np.arange(1, _PARTS + 1) / _PARTS
            _, ways = landing(system, np.sqrt(grid[:, :-1]).ravel(), *window)
            ways = np.concatenate([ways.reshape(len(a), _PARTS - 1, 4), way_b[:, None]], axis=1)
            first = np.argmax(np.any(ways != way_left[:, None], axis=2), axis=1)[:, None]
            way_b = np.take_along_axis(ways, first[..., None], 1)[:, 0]
            b = np.take_along_axis(grid, first, 1)[:, 0]
            a = b - (grid[:, 1] - grid[:, 0])
        found.append(0.5 * (a + b))
        more = np.any(way_b != way_right, axis=1) & (b < right)
        left, right, way_left, way_right = b[more], right[more], way_b[more], way_right[more]
    return np.concatenate([[low, high], *found])


def specular_energy(system: TruthSystem, x0: float, x1: float, y0: float, y1: float, tolerance: float = 1e-11) -> float:
    """Fraction of PSF_G in the rectangle [mm]; the light of the specular image is exp(-sum g) times this.

    Panels in t, rho^2 = a + (b - a) sin^2(pi t/2) between neighbouring kinks a and b, are halved until each differs
    from its halves by less than its share of ``tolerance``. Against the exact annulus and line: 1e-10 or better. A spot
    that collapses to a point on an edge counts half (a quarter at a corner).
    """
    window = x0, x1, y0, y1
    ends = [np.unique(_kinks(system, window, a * a, b * b)) for a, b in rings_that_may_land(system, *window)]
    if not ends:
        return 0.0
    first, last = (np.concatenate([e[part] for e in ends]) for part in (slice(None, -1), slice(1, None)))

    def integrate(panels: np.ndarray) -> np.ndarray:  # [n, 4] of (a, b, t0, t1)
        a, b, t0, t1 = panels.T[..., None]
        t = 0.5 * np.pi * (t0 + 0.5 * (t1 - t0) * (1.0 + _NODES))
        fraction, _ = landing(system, np.sqrt(a + (b - a) * np.sin(t) ** 2).ravel(), *window)
        return (0.25 * np.pi * (b - a) * (t1 - t0))[:, 0] * ((fraction.reshape(t.shape) * np.sin(2.0 * t)) @ _WEIGHTS)

    panels = np.stack([first, last, np.zeros_like(first), np.ones_like(first)], axis=1)
    inner = system.obscuration**2
    share = tolerance * (1.0 - inner) / (2.0 * len(panels))
    coarse = integrate(panels)
    total = 0.0
    for _ in range(60):
        left, right = panels.copy(), panels.copy()
        left[:, 3] = right[:, 2] = 0.5 * (panels[:, 2] + panels[:, 3])
        halves = integrate(np.concatenate([left, right])).reshape(2, -1)
        poor = np.abs(halves.sum(axis=0) - coarse) > share
        total += float(halves[:, ~poor].sum())
        if not poor.any():
            break
        panels, coarse = np.concatenate([left[poor], right[poor]]), halves[:, poor].ravel()
    else:
        total += float(coarse.sum())
    return total / (1.0 - inner)
