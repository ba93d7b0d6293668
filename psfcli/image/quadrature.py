"""Quadrature: Gauss's rule, and adaptive integration of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_LARGEST_PANEL = 64
_MOST_NODES = 400_000
_LEAST_SHARE = 0.1  # few slices hold a kink of any one function: each may use this share of the tolerance
_BEND = 0.4  # of the change in curvature, in units of a twelfth of the slice: about what a kink there takes
# of the doubt of two slices together, that each may not fall below: a kink t^p, p from 1/5 to 1, then errs by no more
# than 2.5 times what is told wherever it lies (7.5 times without), and smooth doubts fall by a factor of 16
_LEAST_FALL = 0.125
_ALIKE = 1e-6  # relative: widths that differ by rounding alone
_PLACE = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # of Simpson's nodes on the halves of a slice
_PLACE_WEIGHT = np.array([1.0, 4.0, 2.0, 4.0, 1.0]) / 12.0


@lru_cache(maxsize=256)
def gauss_legendre(count: int) -> tuple[Real, Real]:
    """Nodes and weights of Gauss's rule on (-1, 1), shape (count,), not to be written to; weights add to 2."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight


def gauss_panels(count: int, largest: int = _LARGEST_PANEL) -> tuple[Real, Real]:
    """Nodes and weights on (-1, 1), ``count`` or more, of Gauss's rule on equal panels of at most ``largest`` nodes."""
    panels = 1 + (count - 1) // largest
    node, weight = gauss_legendre(-(-count // panels))
    start = -1.0 + 2.0 * np.arange(panels)[:, None] / panels
    return (start + (node + 1.0) / panels).ravel(), np.tile(weight / panels, panels)


def gauss_rule(x: Real, mass: Real, count: int) -> tuple[Real, Real]:
    """Nodes and masses of the ``count``-point Gauss rule of the discrete measure ``mass`` at ``x`` (Stieltjes)."""
    alpha, beta = np.empty(count), np.empty(count)
    previous, current = np.zeros_like(x), np.ones_like(x)
    norm = mass.sum()
    total = norm
    for k in range(count):
        alpha[k] = np.sum(mass * x * current**2) / norm
        following = (x - alpha[k]) * current - (beta[k - 1] if k else 0.0) * previous
        following_norm = np.sum(mass * following**2)
        beta[k] = following_norm / norm
        previous, current, norm = current, following, following_norm
    jacobi = np.diag(alpha) + np.diag(np.sqrt(beta[:-1]), 1) + np.diag(np.sqrt(beta[:-1]), -1)
    nodes, vectors = np.linalg.eigh(jacobi)
    return nodes, total * vectors[0] ** 2


@dataclass(frozen=True, slots=True)
class Rule:
    """A quadrature rule for several groups of functions: slices from ``left`` to ``right`` of each ``group``; the

    ``integral`` (groups, functions) of each function it was made for, and the estimated ``error`` (groups,) of the
    worst in each group.
    """

    left: Real
    right: Real
    group: Index
    integral: Real
    error: Real

    def nodes(self, group: int) -> tuple[Real, Real]:
        """Nodes and weights of Simpson's rule on the halves of all slices of a ``group``."""
        mine = self.group == group
        left, width = self.left[mine, None], (self.right - self.left)[mine, None]
        return (left + _PLACE * width).ravel(), (_PLACE_WEIGHT * width).ravel()


def integrate_adaptively(
    functions: Callable[[Real, Index], Real], left: Real, right: Real, group: Index, tolerance: Real, *, at_once: int
) -> Rule:
    """A rule for the integrals of ``functions`` over slices from ``left`` to ``right``, about ``at_once`` at a time.

    Within ``tolerance`` (groups,) for each function. ``functions(node, group)`` gives (nodes, functions); the slices
    of a ``group`` (0, 1, ...) follow one another. Slices are judged one by one, and many small errors may add up to a
    large one: then their groups are done again, more strictly. An error exceeds the tolerance only where it would
    take more than a reasonable number of nodes. A group's rule is the same whatever other groups there are.
    """
    rule = _halved_until(functions, left, right, group, tolerance, at_once)
    strictness = np.ones(tolerance.size)
    while True:
        loose = (rule.error > tolerance) & (_PLACE.size * _counts(rule.group, tolerance.size) <= _MOST_NODES)
        if not loose.any():
            return rule
        strictness[loose] *= 2.0 * np.maximum(2.0, rule.error[loose] / tolerance[loose])
        some = loose[group]
        again = _halved_until(functions, left[some], right[some], group[some], tolerance / strictness, at_once)
        keep = ~loose[rule.group]
        rule = Rule(
            np.concatenate([rule.left[keep], again.left]),
            np.concatenate([rule.right[keep], again.right]),
            np.concatenate([rule.group[keep], again.group]),
            np.where(loose[:, None], again.integral, rule.integral),
            np.where(loose, again.error, rule.error),
        )


def _halved_until(
    functions: Callable[[Real, Index], Real], left: Real, right: Real, group: Index, tolerance: Real, at_once: int
) -> Rule:
    """A rule made by halving slices until each is within its share of ``tolerance``.

    Each slice is integrated by Simpson's rule and by that on its halves: closed rules, so that a kink always lies
    between two points that were seen. Its ``_doubt`` may be small by chance where a kink lies near one of its ends: two
    neighbours that both seem good must be so beside the doubt of the slice that they make together. The error is the
    sum of the doubts of all slices, for the worst function: a few times what the last halving left, and no less is
    told, for kinks may agree by chance.
    """
    groups = tolerance.size
    whole = np.bincount(group, right - left, groups)
    finished: list[tuple[Real, Real, Index]] = []
    sums = np.zeros((groups, 1))  # of doubts and of integrals
    count = np.zeros(groups, dtype=np.intp)
    for part in _parts(group, at_once):  # a few slices at a time, to the end: little is held
        a, b, g = left[part], right[part], group[part]
        fa, fm, fb = _at_ends_and_middles(functions, a, b, g)
        count += 3 * _counts(g, groups)
        one, other = _neighbours(a, b, g)
        together = _doubt(fa[one], fm[one], fb[one], fm[other], fb[other], 2.0 * (b - a)[one])
        while a.size:
            middle = 0.5 * (a + b)
            halves = np.concatenate([0.5 * (a + middle), 0.5 * (middle + b)])
            fl, fr = np.split(functions(halves, np.concatenate([g, g])), 2)
            count += 2 * _counts(g, groups)
            doubt = _doubt(fa, fl, fm, fr, fb, b - a)
            share = tolerance[g] * np.maximum((b - a) / whole[g], _LEAST_SHARE)
            good = doubt.max(axis=1) <= share
            both = np.flatnonzero(good[one] & good[other])
            least = _LEAST_FALL * together[both]
            most = least.max(axis=1)
            for each in (one[both], other[both]):
                doubt[each] = np.maximum(doubt[each], least)
                good[each] &= most <= share[each]
            good |= (count > _MOST_NODES)[g]
            done, more = np.flatnonzero(good), np.flatnonzero(~good)
            twelfth = ((b - a)[done] / 12.0)[:, None]
            integral = twelfth * (fa[done] + fb[done] + 4.0 * (fl[done] + fr[done]) + 2.0 * fm[done])
            sums = sums + _sum_by_group(np.concatenate([doubt[done], integral], axis=1), g[done], groups)
            finished.append((a[done], b[done], g[done]))
            together, one, other = doubt[more], np.arange(more.size), more.size + np.arange(more.size)
            a, b, g = (
                np.concatenate([a[more], middle[more]]),
                np.concatenate([middle[more], b[more]]),
                np.concatenate([g[more], g[more]]),
            )
            fa, fm, fb = (
                np.concatenate([fa[more], fm[more]]),
                np.concatenate([fl[more], fr[more]]),
                np.concatenate([fm[more], fb[more]]),
            )
    error, integral = np.split(sums, 2, axis=1)
    lefts, rights, of = zip(*finished, strict=True)
    return Rule(
        np.concatenate(lefts),
        np.concatenate(rights),
        np.concatenate(of),
        integral,
        error.max(axis=1, initial=0.0),
    )


def _doubt(fa: Real, fl: Real, fm: Real, fr: Real, fb: Real, width: Real) -> Real:
    """How well slices of some ``width`` (n,) are known by functions (n, functions) at their quarters: shape of these.

    What Simpson's rule on the halves changes, or what the curvature changes from one half to the other, if more: a kink
    may satisfy the one by chance, not both.
    """
    inner, outer = fl + fr, fa + fb
    change = np.abs(4.0 * inner - outer - 6.0 * fm)
    bend = _BEND * np.abs(fb - fa + 2.0 * (fl - fr))
    doubt: Real = np.maximum(change, bend) * (width / 12.0)[:, None]
    return doubt


def _neighbours(a: Real, b: Real, group: Index) -> tuple[Index, Index]:
    """Which slices follow one another in a group and are equally wide."""
    width = b - a
    alike = np.abs(width[1:] - width[:-1]) < _ALIKE * width[1:]
    one = np.flatnonzero(alike & (a[1:] == b[:-1]) & (group[1:] == group[:-1]))
    return one, one + 1


def _parts(group: Index, at_once: int) -> Iterator[slice]:
    """The slices of whole groups, a few at a time; those of a large ``group`` in parts of their own."""
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    pieces = [p for a, b in pairwise([*starts.tolist(), group.size]) for p in range(a, b, at_once)]
    first = 0
    for here, following in pairwise([*pieces, group.size]):
        if following - first > at_once:
            yield slice(first, here)
            first = here
    yield slice(first, group.size)


def _at_ends_and_middles(
    functions: Callable[[Real, Index], Real], a: Real, b: Real, group: Index
) -> tuple[Real, Real, Real]:
    """The functions at both ends and the middle of slices; an end that is the next one's start is seen once."""
    fresh = np.ones(a.size, dtype=bool)
    fresh[1:] = (a[1:] != b[:-1]) | (group[1:] != group[:-1])
    starts = int(np.count_nonzero(fresh))
    values = functions(np.concatenate([a[fresh], 0.5 * (a + b), b]), np.concatenate([group[fresh], group, group]))
    each = np.arange(a.size)
    start = np.where(fresh, np.cumsum(fresh) - 1, starts + a.size + each - 1)
    return values[start], values[starts : starts + a.size], values[starts + a.size :]


def _counts(group: Index, groups: int) -> Index:
    """How many there are of each ``group``."""
    return np.bincount(group, minlength=groups)


def _sum_by_group(rows: Real, group: Index, groups: int) -> Real:
    """Sums of the ``rows`` of each group, shape (groups, columns), whatever other groups there are."""
    total = np.zeros((groups, rows.shape[1]))
    if rows.shape[0]:
        order = np.argsort(group, kind="stable")
        present, start = np.unique(group[order], return_index=True)
        total[present] = np.add.reduceat(rows[order], start, axis=0)
    return total
