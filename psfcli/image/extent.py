"""How far the rays of a spot land: the extremes of cubics in pupil radius over all azimuths, to 1e-10 [mm]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_AZIMUTHS = 256  # looked at first: far closer than the peaks of a few harmonics are
_RISE = 1e-3  # of the range: peaks of a few harmonics rise no more above the samples beside them
_STEPS = 6  # each comes ten times closer to a peak, most of them flat to rounding in the end


def turning_points(fans: Real, inner: float) -> Real:
    """Zeros of the cubics' derivatives within (inner, 1), shape (2, azimuths); 1 where there is none."""
    _, c, b, a = fans * np.array([0.0, 1.0, 2.0, 3.0])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b * b - 4.0 * a * c), b))
        roots = np.stack([q / a, c / q])
        return np.where((roots > inner) & (roots < 1.0), roots, 1.0)


def largest_along_fans(fans: Real, inner: float) -> Real:
    """The largest value of each cubic ``fans`` (4, azimuths) from rho = ``inner`` to 1, shape (azimuths,)."""
    ends = np.broadcast_to([[inner], [1.0]], (2, fans.shape[1]))
    rho = np.concatenate([ends, turning_points(fans, inner)])
    value: Real = ((fans[3] * rho + fans[2]) * rho + fans[1]) * rho + fans[0]
    return value.max(axis=0)


def extents(fans: Callable[[Real, Index], tuple[Real, Real]], inner: float, start: float, stop: float, of: int) -> Real:
    """The bounds x_min, x_max, y_min, y_max of rays from rho = ``inner`` to 1 and azimuth ``start`` to ``stop``.

    Shape (of, 4), for each ``of`` as many spots: ``fans(azimuth, spot)`` gives the cubics of x and of y, (4, azimuths)
    each. The highest peaks among the azimuths looked at first are climbed by parabolas through three points ever closer
    together.
    """
    sign = np.array([-1.0, 1.0, -1.0, 1.0])  # the least is the largest of the opposite
    looked_at = np.linspace(start, stop, _AZIMUTHS + 1)
    x, y = fans(np.tile(looked_at, of), np.repeat(np.arange(of), looked_at.size))
    value = largest_along_fans(np.concatenate([-x, x, -y, y], axis=1), inner).reshape(4 * of, -1)
    largest = value.max(axis=1)
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=-np.inf)
    high = value >= largest[:, None] - _RISE * np.ptp(value, axis=1)[:, None]
    row, place = np.nonzero(high & (value >= padded[:, :-2]) & (value >= padded[:, 2:]))
    side, spot = np.divmod(row, of)
    peak, step = looked_at[place], (stop - start) / _AZIMUTHS
    sides, spots, some = np.tile(side, 3), np.tile(spot, 3), np.arange(3 * row.size)
    for _ in range(_STEPS):
        both = np.stack(fans((peak + step * np.array([[-1.0], [0.0], [1.0]])).ravel(), spots))
        along = largest_along_fans(sign[sides] * both[sides // 2, :, some].T, inner)
        before, at, after = along.reshape(3, -1)
        np.maximum.at(largest, row, at)
        bend = before - 2.0 * at + after
        hop = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < 0.0)
        peak = np.clip(peak + step * np.clip(hop, -5.0, 5.0), start, stop)
        step *= 0.1
    bounds: Real = sign * largest.reshape(4, of).T + 0.0
    return bounds
