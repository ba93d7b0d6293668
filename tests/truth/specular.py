"""The unscattered light in a rectangle: the lit fraction of each ring of the pupil (``rings``), over rho^2.

Rings that may land in the rectangle are found first, then the kinks of the fraction among them, where the way a ring
passes the rectangle's edges changes. Between kinks a substitution takes the square roots off both ends, and panels are
halved until they stand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .geometry import ray_error
from .rings import landing

if TYPE_CHECKING:
    from .system import TruthSystem

# Clenshaw-Curtis, exact to degree 12: its nodes include the ends, where a kink would hide from a Gauss rule
_NODES = np.cos(np.pi * np.arange(13) / 12.0)
_WEIGHTS = np.linalg.solve(np.polynomial.legendre.legvander(_NODES, 12).T, np.eye(13)[0] * 2.0)

_RINGS = 97  # among which kinks are looked for, in each interval
_PARTS, _ROUNDS = 8, 9  # of a search: 1e-8 of what it begins with
_MOST_CELLS = 4000


def rings_that_may_land(system: TruthSystem, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Intervals of rho, shape [n, 2], outside which no ray lands in the rectangle [mm].

    Cells of the pupil are quartered, and those are kept whose rays may land there: by the middle of a cell, its own
    slopes, and the greatest second derivatives of the ray errors anywhere. Until a cell's light is no wider than the
    rectangle (or ``_MOST_CELLS`` are kept): however small the rectangle, its rings are found.
    """
    first, last = system.sector or (-np.pi, np.pi)

    def landing_at(r: np.ndarray, f: np.ndarray) -> np.ndarray:
        return np.array(ray_error(system, r * np.cos(f), r * np.sin(f)))

    fan = landing_at(np.linspace(system.obscuration, 1.0, 33)[:, None], np.linspace(first, last, 193))
    dr, df = (1.0 - system.obscuration) / 32.0, (last - first) / 192.0
    bends = [
        1.2 * np.abs(difference).max(axis=(1, 2))[:, None] / size
        for difference, size in (
            (np.diff(fan, 2, axis=1), dr**2),
            (np.diff(np.diff(fan, axis=1), axis=2), dr * df),
            (np.diff(fan, 2, axis=2), df**2),
        )
    ]
    cells = np.array([[system.obscuration, 1.0, first, last]])
    for _ in range(40):
        r0, r1, f0, f1 = cells.T
        r, f, half_r, half_f = 0.5 * (r0 + r1), 0.5 * (f0 + f1), 0.5 * (r1 - r0), 0.5 * (f1 - f0)
        ex, ey = landing_at(r, f)
        slopes = np.abs(landing_at(r1, f) - landing_at(r0, f)) + np.abs(landing_at(r, f1) - landing_at(r, f0))
        bent = bends[0] * half_r**2 + 2.0 * bends[1] * half_r * half_f + bends[2] * half_f**2
        wide_x, wide_y = 0.5 * (slopes + bent)
        near = (ex + wide_x >= x0) & (ex - wide_x <= x1) & (ey + wide_y >= y0) & (ey - wide_y <= y1)
        cells, r, f = cells[near], r[near], f[near]
        small = 2.0 * wide_x.max() <= x1 - x0 and 2.0 * wide_y.max() <= y1 - y0
        if len(cells) == 0 or len(cells) > _MOST_CELLS or (small and r1[0] - r0[0] < 0.1):
            break
        r0, r1, f0, f1 = cells.T
        cells = np.concatenate(
            [np.stack(quarter, axis=1) for quarter in ((r0, r, f0, f), (r0, r, f, f1), (r, r1, f0, f), (r, r1, f, f1))]
        )
    return _joined(cells[:, :2])


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
