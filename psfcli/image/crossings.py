"""Ray fans cut where they cross the edges of cells.

Along one pupil azimuth the landing point is a cubic in rho. Its crossings with the edges cut the radius into pieces
that land in one cell each, of power proportional to the difference of rho^2: exact in radius, without ray noise and
without a density, so that a perfect image, a line focus and a caustic are as good as any. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import ray_fans
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_LAGUERRE_STEPS = 60


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of ray fans, each within one cell: the share of its fan's light, the landing point of its middle [mm]

    and the index of its fan; shares of a fan add to 1.
    """

    share: Real
    x: Real
    y: Real
    fan: Index


def pieces_between(
    telescope: Telescope, field: Field, azimuth: Real, edges_x: Real, edges_y: Real, origin: Real | None = None
) -> Pieces:
    """The fans along ``azimuth`` [rad] cut where x is one of ``edges_x`` or y one of ``edges_y``, both increasing.

    Edges and landing points count from the Gaussian image point or, for each fan, from its ``origin`` (2, azimuths).
    """
    inner = telescope.pupil.obscuration
    fans_x, fans_y = ray_fans(telescope, field, azimuth)
    if origin is not None:
        fans_x[0] -= origin[0]
        fans_y[0] -= origin[1]
    each = np.arange(azimuth.size)
    crossings = [_bracketed_crossings(fans, inner, edges) for fans, edges in ((fans_x, edges_x), (fans_y, edges_y))]
    cubics, start, stop, crossing_fan = (np.concatenate(column, axis=-1) for column in zip(*crossings, strict=True))
    fan = [each, each, crossing_fan]
    rho = [np.full(azimuth.size, inner), np.ones(azimuth.size), _root_between(cubics, start, stop)]
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


def _bracketed_crossings(fans: Real, inner: float, edges: Real) -> tuple[Real, Real, Real, Index]:
    """Every crossing of the cubics ``fans`` (4, azimuths) with the ``edges`` for inner < rho < 1.

    Returns the cubics less their edges, shape (4, crossings), brackets in which each has one root, and fan indices.
    Between its turning points a cubic is monotone and meets each edge in its range once.
    """
    turning = np.sort(_turning_points(fans, inner), axis=0)
    limits = np.concatenate([np.full((1, fans.shape[1]), inner), turning, np.ones((1, fans.shape[1]))])
    value = _cubic(fans[:, None, :], limits)
    low, high = np.minimum(value[1:], value[:-1]), np.maximum(value[1:], value[:-1])
    first = np.searchsorted(edges, low.ravel(), side="right")
    count = np.maximum(np.searchsorted(edges, high.ravel(), side="left") - first, 0)
    branch = np.repeat(np.arange(count.size), count)
    edge = edges[np.arange(branch.size) + np.repeat(first - np.cumsum(count) + count, count)]
    fan = branch % fans.shape[1]
    cubics = fans[:, fan]
    cubics[0] -= edge
    return cubics, limits[:-1].ravel()[branch], limits[1:].ravel()[branch], fan


def _turning_points(fans: Real, inner: float) -> Real:
    """Zeros of the cubics' derivatives within (inner, 1), shape (2, azimuths); 1 where there is none."""
    _, c, b, a = fans * np.array([0.0, 1.0, 2.0, 3.0])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b * b - 4.0 * a * c), b))
        roots = np.stack([q / a, c / q])
        return np.where((roots > inner) & (roots < 1.0), roots, 1.0)


def _root_between(cubics: Real, start: Real, stop: Real) -> Real:
    """The root of each of the ``cubics`` (4, n) within (start, stop), where it has one: Laguerre's steps in a bracket.

    Good to rounding; at a root about to become double that is the square root of rounding, in rho.
    """
    low, high = start, stop
    at_low, at_high = _cubic(cubics, low), _cubic(cubics, high)
    rising = at_high > at_low
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = at_low / (at_low - at_high)
    root = low + (high - low) * np.clip(np.nan_to_num(fraction, nan=0.5), 0.02, 0.98)
    active = np.arange(root.size)
    noise = 4.0 * np.finfo(np.float64).eps * np.abs(cubics).sum(axis=0)
    for _ in range(_LAGUERRE_STEPS):
        if active.size == 0:
            break
        c0, c1, c2, c3 = cubics
        rho = root[active]
        value = ((c3 * rho + c2) * rho + c1) * rho + c0
        slope = (3.0 * c3 * rho + 2.0 * c2) * rho + c1
        curvature = 6.0 * c3 * rho + 2.0 * c2
        below = (value < 0.0) == rising
        low, high = np.where(below, rho, low), np.where(below, high, rho)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.sqrt(np.maximum(4.0 * slope**2 - 6.0 * value * curvature, 0.0))
            following = rho - 3.0 * value / (slope + np.copysign(spread, slope))
        following = np.where((following > low) & (following < high), following, 0.5 * (low + high))
        unsolved = np.abs(value) > noise
        root[active] = np.where(unsolved, following, rho)
        moving = unsolved & (np.abs(following - rho) > 1e-15)
        active, cubics, low, high, rising, noise = (
            active[moving],
            cubics[:, moving],
            low[moving],
            high[moving],
            rising[moving],
            noise[moving],
        )
    return root
