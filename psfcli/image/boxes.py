"""The light of the geometrical image in nested squares about points of the image, sharp or blurred a little [mm].

Exact in pupil radius (crossings.py, blurred.py). In azimuth the light of a square is smooth but for kinks, where a fan
begins to meet a corner, the rim or a fold, so slices are halved where they matter (quadrature.py).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blurred import blurred_edge, blurred_light_in_squares
from psfcli.image.crossings import light_in_squares
from psfcli.image.geometric import GeometricalImage, along_fans
from psfcli.image.quadrature import integrate_adaptively
from psfcli.image.unscattered import lit_azimuths, slice_count
from psfcli.surface.mixture import GaussianMixture
from psfcli.telescope.aberration import transverse_aberration_along_azimuths

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_MOST_FIRST_SLICES = 10_000
_MOST_SEEN_AT_ONCE = 300_000  # first slices of all groups: half a gigabyte
_BOXES_TOGETHER = 24
_SLICES_AT_ONCE = 2048
# how far apart neighbouring fans may pass, in the lesser of their distances: each slice is at most four times as far
# out as the one before it
_APART = 3.0
_FOLD = 0.05  # of blur over spot: what light a fold holds that just touches an edge blurred as much


def unscattered_in_boxes(
    points: Sequence[GeometricalImage],
    centres: Sequence[Sequence[tuple[float, float]]],
    half_width: Real,
    tolerance: float,
) -> list[tuple[Real, float]]:
    """Fractions of the unscattered light in squares of increasing ``half_width`` [mm] about the ``centres`` of each of

    the ``points``, shape [centre, box], and their estimated error. All points are of one telescope: they are
    integrated together, which costs less than one by one.
    """
    count = sum(len(some) for some in centres)
    return _over_azimuths(points, centres, half_width, np.full(count, tolerance), light_in_squares)


def blurred_in_boxes(
    point: GeometricalImage,
    centres: Sequence[tuple[float, float]],
    half_width: Real,
    tolerance: Real,
    mixture: GaussianMixture,
) -> tuple[Real, float]:
    """The light of a ``mixture`` of Gaussians far narrower than the spot in the same squares, [centre, box], and its

    estimated error. Within ``tolerance`` (centre,), of all light.
    """
    widths, whole = np.sqrt(mixture.variance), float(mixture.weight.sum())
    edge = blurred_edge(tolerance, mixture)

    def light(fans_x: Real, fans_y: Real, inner: float, half_width: Real) -> Real:
        total = np.zeros((fans_x.shape[1], half_width.size))
        for weight, width in zip(mixture.weight, widths, strict=True):
            total += weight * blurred_light_in_squares(fans_x, fans_y, inner, half_width, float(width), edge)
        return total

    blur = float(widths.min()), edge.widths * float(widths.max())
    (inside,) = _over_azimuths([point], [centres], half_width, tolerance, light, blur, whole)
    return inside


def _over_azimuths(
    points: Sequence[GeometricalImage],
    centres: Sequence[Sequence[tuple[float, float]]],
    half_width: Real,
    tolerance: Real,
    light: Callable[[Real, Real, float, Real], Real],
    blur: tuple[float, float] = (0.0, 0.0),
    whole: float = 1.0,
) -> list[tuple[Real, float]]:
    """The mean over lit azimuths of the ``light`` of fans (x, y, inner, half_width) -> (azimuths, boxes).

    Within ``tolerance`` for each centre of each point. The light varies over no less than the first ``blur`` [mm] of
    the image; squares that reach the second beyond the spot hold the ``whole``.
    """
    smooth, margin = blur
    about = [_About.of(point, centre) for point, some in zip(points, centres, strict=True) for centre in some]
    some = np.searchsorted(half_width, np.array([each.farthest for each in about]) + margin)  # that do not hold all
    inside = np.full((len(about), half_width.size), whole)
    error = np.zeros(len(about))
    if some.any():
        place = np.array([each.centre for each in about])
        relative_field = np.array([each.relative_field for each in about])
        start, stop = np.array([each.azimuths for each in about]).T
        telescope = points[0].telescope
        inner = telescope.pupil.obscuration

        def fans(azimuth: Real, group: Index) -> tuple[Real, Real]:
            """The fans of each group along ``azimuth``, counted from the group's centre."""
            fans_x, fans_y = transverse_aberration_along_azimuths(
                telescope.seidel, tuple(relative_field[group].T), azimuth, telescope.image_slope
            )
            fans_x[0] -= place[group, 0]
            fans_y[0] -= place[group, 1]
            return fans_x, fans_y

        def light_along(boxes: slice, cut: Index, azimuth: Real, group: Index) -> Real:
            """The light in some boxes of fans of the groups that these cut."""
            return light(*fans(azimuth, cut[group]), inner, half_width[boxes])

        extent = np.maximum([each.farthest for each in about], max(smooth, np.finfo(np.float64).tiny))
        seen = np.maximum(tolerance / whole, _FOLD * smooth / extent)
        # an area the size of a square holds its square, a line its length
        smallest = np.clip(half_width[0] / extent, seen, np.sqrt(seen))
        left, right, group = _slices_about(fans, inner, start, stop, seen, smallest)
        # boxes share fans, and each brings its kinks to the others: as many for any points that come together
        for first in range(0, int(some.max()), _BOXES_TOGETHER):
            boxes, cut = slice(first, min(first + _BOXES_TOGETHER, int(some.max()))), np.flatnonzero(some > first)
            own = np.isin(group, cut)
            rule = integrate_adaptively(
                functools.partial(light_along, boxes, cut),
                left[own],
                right[own],
                np.searchsorted(cut, group[own]),
                (tolerance * (stop - start))[cut],
                at_once=_SLICES_AT_ONCE,
            )
            inside[cut, boxes] = np.minimum(rule.integral / (stop - start)[cut, None], whole)
            error[cut] = np.maximum(error[cut], rule.error / (stop - start)[cut])
        inside[np.arange(half_width.size) >= some[:, None]] = whole
    ends = np.cumsum([len(some) for some in centres])
    return [
        (rows, float(errors.max()))
        for rows, errors in zip(np.split(inside, ends[:-1]), np.split(error, ends[:-1]), strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _About:
    """Boxes about one ``centre`` [mm] of one image: lit ``azimuths``, and a half width that holds the whole spot."""

    centre: tuple[float, float]
    relative_field: tuple[float, float]
    azimuths: tuple[float, float]
    farthest: float

    @classmethod
    def of(cls, point: GeometricalImage, centre: tuple[float, float]) -> _About:
        """The boxes about ``centre`` of ``point``."""
        spot, (x, y) = point.spot, centre
        return cls(
            centre,
            point.telescope.relative_field(point.field),
            lit_azimuths(point, half=point.mirror_symmetric and x == 0.0),
            1.01 * max(spot.x_max - x, x - spot.x_min, spot.y_max - y, y - spot.y_min),
        )


def _slices_about(
    fans: Callable[[Real, Index], tuple[Real, Real]],
    inner: float,
    start: Real,
    stop: Real,
    tolerance: Real,
    smallest: Real,
) -> tuple[Real, Real, Index]:
    """First slices (left, right, group) for boxes about the origin of each group, where they shrink to nothing.

    Slices whose fans pass at a distance d are not much wider there than d, down to the ``smallest`` (groups,) box, a
    part of the farthest ray's distance.
    """
    counts = [min(slice_count(a, b, t), _MOST_SEEN_AT_ONCE) for a, b, t in zip(start, stop, tolerance, strict=True)]
    together = np.cumsum(counts) // _MOST_SEEN_AT_ONCE  # as many groups as memory allows
    found = []
    for some in (np.flatnonzero(together == this) for this in np.unique(together)):
        bounds = np.concatenate([np.linspace(start[n], stop[n], counts[n] + 1) for n in some])
        group = np.repeat(some, np.array(counts)[some] + 1)
        found.append(_no_wider_than_distant(fans, inner, bounds, group, smallest))
    left, right, group = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return left, right, group


def _no_wider_than_distant(
    fans: Callable[[Real, Index], tuple[Real, Real]], inner: float, bound: Real, group: Index, least: Real
) -> tuple[Real, Real, Index]:
    """Slices (left, right, group) between neighbouring ``bound`` of a ``group``, halved where they are wide.

    Where fans pass at a distance d of the origin slices are no wider than three times d, or ``least`` (groups,) of the
    farthest ray; a group of _MOST_FIRST_SLICES is halved no more.
    """
    rho = np.linspace(inner, 1.0, 33)
    found: list[tuple[Real, Real, Index]] = []
    while True:
        fans_x, fans_y = fans(bound, group)
        x, y = along_fans(fans_x, rho), along_fans(fans_y, rho)
        distance = _length(x, y)
        hop = _length(x[1:] - x[:-1], y[1:] - y[:-1])
        # the fan may come closer between two of its points, by half the way from one to the next
        closest = distance.copy()
        closest[:-1] -= 0.5 * hop
        np.minimum(closest[1:], distance[1:] - 0.5 * hop, out=closest[1:])
        farthest = np.zeros(least.size)
        np.maximum.at(farthest, group, distance.max(axis=0))
        closest = np.maximum(closest, (least * farthest)[group])
        width = _length(x[:, 1:] - x[:, :-1], y[:, 1:] - y[:, :-1])
        slices = np.flatnonzero(group[1:] == group[:-1])
        wide = np.any(width > _APART * np.minimum(closest[:, 1:], closest[:, :-1]), axis=0)
        split = slices[wide[slices] & (np.bincount(group) <= _MOST_FIRST_SLICES)[group[slices]]]
        again = np.isin(group, group[split])
        slices = slices[~again[slices]]
        found.append((bound[slices], bound[slices + 1], group[slices]))
        if split.size == 0:
            left, right, of = (np.concatenate(parts) for parts in zip(*found, strict=True))
            order = np.argsort(of, kind="stable")
            return left[order], right[order], of[order]
        middle = 0.5 * (bound[split] + bound[split + 1])
        bound, group = np.insert(bound, split + 1, middle), np.insert(group, split + 1, group[split])
        again = np.insert(again, split + 1, True)
        bound, group = bound[again], group[again]


def _length(x: Real, y: Real) -> Real:
    """What hypot gives, faster, where squares neither overflow nor matter when they vanish."""
    length: Real = np.sqrt(x * x + y * y)
    return length
