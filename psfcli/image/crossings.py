"""Ray fans cut where they cross the edges of cells and of nested squares.

Along one pupil azimuth the landing point is a cubic in rho. Its crossings with the edges cut the radius into pieces
that land in one cell each, of power proportional to the difference of rho^2: exact in radius, without ray noise and
without a density, so that a perfect image, a line focus and a caustic are as good as any. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.extent import turning_points

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_FREE_STEPS = 3  # of Laguerre's, after which nearly every root is good to rounding
_LAGUERRE_STEPS = 60
_ON_CORNER = 1e-9  # relative distance from a square's corner at which a crossing counts half for either side


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of ray fans, each within one cell: the share of its fan's light, the landing point of its middle [mm]

    and the index of its fan; shares of a fan add to 1.
    """

    share: Real
    x: Real
    y: Real
    fan: Index


def pieces_between(fans_x: Real, fans_y: Real, inner: float, edges_x: Real, edges_y: Real) -> Pieces:
    """Fans, the cubics ``fans_x`` and ``fans_y`` (4, azimuths) in rho from ``inner`` to 1, cut where x is one of

    ``edges_x`` or y one of ``edges_y``, both increasing.
    """
    azimuths = fans_x.shape[1]
    branches = Branches.of(np.concatenate([fans_x, fans_y], axis=1), inner)
    cut = _crossings(branches, [edges_x, edges_y], np.zeros(2 * azimuths))
    start, stop, which = stretches(cut.fan % azimuths, cut.rho, azimuths, inner)
    middle = 0.5 * (start + stop)
    return Pieces(
        share=(stop - start) * (stop + start) / (1.0 - inner**2),
        x=cubic(fans_x[:, which], middle),
        y=cubic(fans_y[:, which], middle),
        fan=which,
    )


def stretches(fan: Index, rho: Real, fans: int, inner: float) -> tuple[Real, Real, Index]:
    """The radius of each of ``fans`` from ``inner`` to 1 cut at ``rho``: start, stop and fan of every stretch."""
    each = np.arange(fans)
    all_fan = np.concatenate([each, each, fan])
    all_rho = np.concatenate([np.full(fans, inner), np.ones(fans), rho])
    order = np.argsort(2.0 * all_fan + all_rho)  # one key sorts in half the time, where rounding leaves it the order
    within = np.diff(all_fan[order]) == 0
    if np.any(np.diff(all_rho[order])[within] < 0.0):
        order = np.lexsort((all_rho, all_fan))
    all_fan, all_rho = all_fan[order], all_rho[order]
    return all_rho[:-1][within], all_rho[1:][within], all_fan[1:][within]


def light_in_squares(fans_x: Real, fans_y: Real, inner: float, half_width: Real) -> Real:
    """The share of each fan's light in squares of increasing ``half_width`` about the origin, shape (azimuths, boxes).

    ``fans_x``, ``fans_y`` (4, azimuths) are the landing points from rho = ``inner`` to 1. A fan that leaves a square
    at rho leaves rho^2 behind, one that enters takes it away: no piece need be known. Crossings at a corner count half
    for either side, so that a fan along a diagonal is counted once.
    """
    azimuths, boxes = fans_x.shape[1], half_width.size
    branches = Branches.of(np.concatenate([fans_x, fans_y], axis=1), inner)
    cut = _crossings(branches, [np.concatenate([-half_width[::-1], half_width])], np.roll(branches.closest(), azimuths))
    upper = cut.edge >= boxes
    box = np.where(upper, cut.edge - boxes, boxes - 1 - cut.edge)
    w = half_width[box]
    fan = cut.fan % azimuths
    across = np.abs(cubic(branches.fans.take(np.where(cut.fan < azimuths, fan + azimuths, fan), axis=1), cut.rho)) - w
    counted = np.where(np.abs(across) <= _ON_CORNER * w, 0.5, across < 0.0)
    outward = np.where(upper == cut.rising, 1.0, -1.0)
    crossed = np.bincount(fan * boxes + box, outward * counted * cut.rho**2, azimuths * boxes)
    light = crossed.astype(np.float64, copy=False).reshape(azimuths, boxes)  # counts of nothing are integers
    at_inner, at_rim = (np.abs(branches.value[end]).reshape(2, azimuths).max(axis=0)[:, None] for end in (0, -1))
    light += at_rim <= half_width
    if inner > 0.0:
        light -= inner**2 * (at_inner <= half_width)
        light /= 1.0 - inner**2
    return light


@dataclass(frozen=True, slots=True)
class Branches:
    """Cubics ``fans`` (4, azimuths), their turning points between inner and 1 with both ends, and the values there.

    ``rho`` and ``value`` (4, azimuths): between one row and the next a cubic is monotone.
    """

    fans: Real
    rho: Real
    value: Real

    @classmethod
    def of(cls, fans: Real, inner: float) -> Branches:
        """The branches of ``fans`` from ``inner`` to 1."""
        one, other = turning_points(fans, inner)
        rho = np.stack([np.full_like(one, inner), np.minimum(one, other), np.maximum(one, other), np.ones_like(one)])
        return cls(fans, rho, cubic(fans[:, None, :], rho))

    def closest(self) -> Real:
        """The distance from zero that each cubic keeps, shape (azimuths,)."""
        distance: Real = np.maximum(np.maximum(self.value.min(axis=0), -self.value.max(axis=0)), 0.0)
        return distance


@dataclass(frozen=True, slots=True)
class _Crossings:
    """Where fans cross edges: pupil radius, indices of fan and edge, and whether the coordinate rises there."""

    rho: Real
    fan: Index
    edge: Index
    rising: NDArray[np.bool_]


def _crossings(branches: Branches, edges: Sequence[Real], beyond: Real) -> _Crossings:
    """Every crossing of the fans with increasing ``edges`` that lie farther from zero than ``beyond``, per fan.

    As many equal parts of the fans as there are ``edges`` each meet their own, counted from the first of all. A branch
    meets each edge in its range once.
    """
    fans = branches.fans.shape[1]
    live = np.flatnonzero(branches.rho[1:] > branches.rho[:-1])  # most fans have one branch
    before, after = branches.value[:-1].ravel()[live], branches.value[1:].ravel()[live]
    low, high, of = np.minimum(before, after), np.maximum(before, after), live % fans
    first, last = np.empty(live.size, dtype=np.intp), np.empty(live.size, dtype=np.intp)
    passed = 0
    for n, own in enumerate(edges):
        part = slice(None) if len(edges) == 1 else of * len(edges) // fans == n
        first[part] = passed + np.searchsorted(own, low[part], side="right")
        last[part] = passed + np.searchsorted(own, high[part], side="left")
        passed += own.size
    count = np.maximum(last - first, 0)
    branch = np.repeat(np.arange(count.size), count)
    edge = np.arange(branch.size) + (first - np.cumsum(count) + count)[branch]
    place = np.concatenate(edges)
    if np.any(beyond > 0.0):
        some = np.abs(place[edge]) > beyond[of[branch]]
        branch, edge = branch[some], edge[some]
    fan = of[branch]
    cubics = branches.fans.take(fan, axis=1)
    cubics[0] -= place[edge]
    start, stop = branches.rho[:-1].ravel()[live], branches.rho[1:].ravel()[live]
    rho = root_between(cubics, start[branch], stop[branch])
    return _Crossings(rho, fan, edge, (after > before)[branch])


def cubic(coefficients: Real, rho: Real) -> Real:
    """The cubics ``coefficients`` (4, n), of rising power, at ``rho``; shape of both."""
    a0, a1, a2, a3 = coefficients
    value: Real = a3 * rho
    value += a2
    value *= rho
    value += a1
    value *= rho
    value += a0
    return value


def root_between(cubics: Real, start: Real, stop: Real) -> Real:
    """The root of each of the ``cubics`` (4, n) within (start, stop), where it has one.

    A few of Laguerre's steps from the chord; what still moves then goes on in a bracket. Good to rounding; at a root
    about to become double that is the square root of rounding, in rho.
    """
    at_start, at_stop = cubic(cubics, start), cubic(cubics, stop)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = at_start / (at_start - at_stop)
    root = start + (stop - start) * fraction
    for _ in range(_FREE_STEPS):
        root = np.minimum(np.maximum(_laguerre(cubics, root)[0], start), stop)
    unsolved = np.flatnonzero(~(np.abs(cubic(cubics, root)) <= _noise(cubics)))
    if unsolved.size:
        rising = (at_stop > at_start)[unsolved]
        root[unsolved] = _bracketed_root(cubics[:, unsolved], root[unsolved], start[unsolved], stop[unsolved], rising)
    return root


def _noise(cubics: Real) -> Real:
    """What rounding leaves of the ``cubics`` (4, n) at a root within rho <= 1."""
    noise: Real = 4.0 * np.finfo(np.float64).eps * np.abs(cubics).sum(axis=0)
    return noise


def _laguerre(cubics: Real, rho: Real) -> tuple[Real, Real]:
    """One step of Laguerre's method from ``rho``, and the value there."""
    # in place: new arrays take longer than what is computed in them
    _, c1, c2, c3 = cubics
    value = cubic(cubics, rho)
    half_curvature = c3 * rho
    half_curvature *= 3.0
    half_curvature += c2
    slope = half_curvature + c2
    slope *= rho
    slope += c1
    step = 3.0 * value
    half_curvature *= step
    spread = slope * slope
    spread -= half_curvature
    np.maximum(spread, 0.0, out=spread)
    np.sqrt(spread, out=spread)
    spread *= 2.0
    np.copysign(spread, slope, out=spread)
    spread += slope
    with np.errstate(divide="ignore", invalid="ignore"):
        step /= spread
    return rho - step, value


def _bracketed_root(cubics: Real, start: Real, low: Real, high: Real, rising: NDArray[np.bool_]) -> Real:
    """Laguerre's steps from ``start``, halving the bracket from ``low`` to ``high`` where they would leave it."""
    root = np.where((start > low) & (start < high), start, 0.5 * (low + high))
    active = np.arange(root.size)
    noise = _noise(cubics)
    for _ in range(_LAGUERRE_STEPS):
        if active.size == 0:
            break
        rho = root[active]
        following, value = _laguerre(cubics[:, active], rho)
        below = (value < 0.0) == rising[active]
        low[active], high[active] = np.where(below, rho, low[active]), np.where(below, high[active], rho)
        inside = (following > low[active]) & (following < high[active])
        following = np.where(inside, following, 0.5 * (low[active] + high[active]))
        unsolved = np.abs(value) > noise[active]
        root[active] = np.where(unsolved, following, rho)
        active = active[unsolved & (np.abs(following - rho) > 1e-15)]
    return root
