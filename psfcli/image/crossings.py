"""Ray fans cut where they cross the edges of cells.

Along one pupil azimuth the landing point is a cubic in rho. Its crossings with the edges cut the radius into pieces that
land in one cell each, of power proportional to the difference of rho^2: exact in radius, without ray noise, and without
a density, so that a perfect image, a line focus and a caustic are as good as any. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import ray_fans
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_NEWTON_STEPS = 60


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of ray fans, each within one cell: the share of its fan's light, the landing point of its middle [mm]

    and the index of its fan; shares of a fan add to 1.
    """

    share: Real
    x: Real
    y: Real
    fan: Index


def pieces_between(telescope: Telescope, field: Field, azimuth: Real, edges_x: Real, edges_y: Real) -> Pieces:
    """The fans along ``azimuth`` [rad] cut at every crossing with x in ``edges_x`` and y in ``edges_y``, both increasing."""
    inner = telescope.pupil.obscuration
    fans_x, fans_y = ray_fans(telescope, field, azimuth)
    each = np.arange(azimuth.size)
    fan = [each, each]
    rho = [np.full(azimuth.size, inner), np.ones(azimuth.size)]
    for fans, edges in ((fans_x, edges_x), (fans_y, edges_y)):
        crossing_fan, crossing_rho = _crossings(fans, inner, edges)
        fan.append(crossing_fan)
        rho.append(crossing_rho)
    all_fan, all_rho = np.concatenate(fan), np.concatenate(rho)
    order = np.lexsort((all_rho, all_fan))
    all_fan, all_rho = all_fan[order], all_rho[order]
    within = all_fan[1:] == all_fan[:-1]
    start, stop, which = all_rho[:-1][within], all_rho[1:][within], all_fan[1:][within]
    middle = 0.5 * (start + stop)
    return Pieces(
        share=(stop - start) * (stop + start) / (1.0 - inner**2),
        x=_cubic(fans_x[:, which], middle),
        y=_cubic(fans_y[:, which], middle),
        fan=which,
    )


def _cubic(coefficients: Real, rho: Real) -> Real:
    a0, a1, a2, a3 = coefficients
    value: Real = ((a3 * rho + a2) * rho + a1) * rho + a0
    return value


def _crossings(fans: Real, inner: float, edges: Real) -> tuple[Index, Real]:
    """Every crossing of the cubics ``fans`` (4, azimuths) with the ``edges`` for inner < rho < 1: azimuth index, rho.

    Between its turning points a cubic is monotone and meets each edge in its range once.
    """
    turning = np.sort(_turning_points(fans, inner), axis=0)
    limits = np.concatenate([np.full((1, fans.shape[1]), inner), turning, np.ones((1, fans.shape[1]))])
    value = _cubic(fans[:, None, :], limits)
    low, high = np.minimum(value[1:], value[:-1]), np.maximum(value[1:], value[:-1])
    first = np.searchsorted(edges, low.ravel(), side="right")
    count = np.searchsorted(edges, high.ravel(), side="left") - first
    count = np.maximum(count, 0)
    branch = np.repeat(np.arange(count.size), count)
    edge = edges[np.arange(branch.size) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)]
    fan = branch % fans.shape[1]
    start, stop = limits[:-1].ravel()[branch], limits[1:].ravel()[branch]
    rising = (value[1:] > value[:-1]).ravel()[branch]
    return fan, _monotone_root(fans[:, fan], edge, start, stop, rising)


def _turning_points(fans: Real, inner: float) -> Real:
    """Zeros of the cubics' derivatives within (inner, 1), shape (2, azimuths); 1 where there is none."""
    _, c, b, a = fans * np.array([0.0, 1.0, 2.0, 3.0])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b * b - 4.0 * a * c), b))
        roots = np.stack([q / a, c / q])
        return np.where((roots > inner) & (roots < 1.0), roots, 1.0)


def _monotone_root(coefficients: Real, target: Real, start: Real, stop: Real, rising: NDArray[np.bool_]) -> Real:
    """The root of cubic = target within (start, stop), where the cubic is monotone: Newton's steps kept in a bracket."""
    low, high = start.copy(), stop.copy()
    rho = 0.5 * (low + high)
    a0, a1, a2, a3 = coefficients
    for _ in range(_NEWTON_STEPS):
        excess = ((a3 * rho + a2) * rho + a1) * rho + (a0 - target)
        below = (excess < 0.0) == rising
        low, high = np.where(below, rho, low), np.where(below, high, rho)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = excess / ((3.0 * a3 * rho + 2.0 * a2) * rho + a1)
        following = rho - step
        following = np.where((following > low) & (following < high), following, 0.5 * (low + high))
        moved = np.max(np.abs(following - rho), initial=0.0)
        rho = following
        if moved < 1e-14:
            break
    return rho
