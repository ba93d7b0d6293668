"""Gaussians too narrow for the spot's moments, in squares: on a grid of rays or along fans, whichever costs less.

A grid takes rays as close as the Gaussian is wide, in two dimensions; fans cost the same however narrow it is, but more
the finer the answer. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import TAIL, fewer_terms, normal_probability, ray_spacing
from psfcli.image.blurred import terms_for
from psfcli.image.boxes import blurred_in_boxes
from psfcli.image.geometric import GeometricalImage
from psfcli.image.patches import MOST_RAYS, ray_count
from psfcli.image.spot_grid import SpotGrid, spot_grids
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]

# seconds, on any machine only in proportion: of a ray laid on a grid, and of one Gaussian in one box at tolerance 1,
# which grows as Simpson's rule makes it
_RAY_COST, _FAN_COST, _FAN_GROWTH = 1.5e-6, 1.5e-4, -0.25
_LEAST = 1e-13  # of all light: no fan knows it better
_AT_ONCE = 1 << 17  # nodes of the grid, each for a box about a centre: what is computed together


def narrow_in_squares(
    point: GeometricalImage,
    mixture: GaussianMixture,
    centres: Sequence[tuple[float, float]],
    half_width: Real,
    error: Real,
    tolerance: Real,
) -> tuple[Real, float]:
    """PSF_G blurred by the ``mixture`` in squares of increasing ``half_width`` about the ``centres``: [centre, box].

    With it comes the estimated error of what follows fans. Each term, by increasing variance, within its relative
    ``error`` on a grid, or all that follow fans within ``tolerance`` (centre,) of all light. Terms that may err by as
    much as they hold are given to the next narrower one, which reaches no farther; the narrowest of them to the
    heaviest among them.
    """
    strict = error < 1.0
    free = int(np.argmax(np.append(strict, True)))
    if free:
        strict[np.argmax(np.abs(mixture.weight[:free]))] = True
    owner = np.maximum(np.cumsum(strict) - 1, 0)
    weight, variance = np.bincount(owner, mixture.weight).astype(np.float64), mixture.variance[strict]
    width = np.sqrt(variance)
    spacing = ray_spacing(width, error[strict])
    spot, farthest = point.spot, float(half_width[-1])
    x, y = np.array(centres).T
    window = x.min() - farthest, x.max() + farthest, y.min() - farthest, y.max() + farthest
    from_spot = np.maximum.reduce([spot.x_min - x, x - spot.x_max, spot.y_min - y, y - spot.y_max]) - farthest
    reached = from_spot <= TAIL * width[:, None]
    energy, told = np.zeros((len(centres), half_width.size)), 0.0
    seen = reached.any(axis=1)  # narrower ones send nothing to any of the squares
    if not seen.any():
        return energy, told
    weight, variance, spacing, reached = weight[seen], variance[seen], spacing[seen], reached[seen]
    extent = math.hypot(spot.x_max - spot.x_min, spot.y_max - spot.y_min)
    boxes = 1 + int(np.count_nonzero((half_width < extent) & (half_width > 0.01 * extent)))
    fans = boxes * np.cumsum(np.abs(weight)) ** -_FAN_GROWTH * (reached @ tolerance**_FAN_GROWTH)
    terms = terms_for(np.maximum(tolerance, _LEAST), GaussianMixture(weight, variance))
    by_fans = _fewest(ray_count(point, window).at(spacing), fans, terms)
    if by_fans:
        some = np.flatnonzero(reached[by_fans - 1]).tolist()
        enough = np.maximum(tolerance[some], _LEAST)
        narrowest = fewer_terms(GaussianMixture(weight[:by_fans], variance[:by_fans]), terms)
        along, told = blurred_in_boxes(point, [centres[n] for n in some], half_width, enough, narrowest)
        energy[some] += along
    wider = GaussianMixture(weight[by_fans:], variance[by_fans:])
    for grid in spot_grids(point, wider, spacing[by_fans:], window):
        energy += _by_grid(grid, centres, half_width)
    return energy, told


def _fewest(rays: Real, fans: Real, terms: int) -> int:
    """How many of the narrowest terms are cheaper along fans; ``fans`` is the cost of one term, given the last.

    No more than ``terms`` go along fans. Like widths share a grid: it takes as many rays as the one that asks for most.
    """
    along = _FAN_COST * np.append(0.0, fans) * np.minimum(np.arange(rays.size + 1), terms)
    most = np.maximum.accumulate(rays[::-1])[::-1]
    grid = _RAY_COST * np.append(np.where(most > MOST_RAYS, np.inf, most), 0.0)
    return int(np.argmin(along + grid))


def _by_grid(grid: SpotGrid, centres: Sequence[tuple[float, float]], half_width: Real) -> Real:
    """The light of the grid's mixture in each square, shape [centre, box]; squares beyond it hold all."""
    energy = np.full((len(centres), half_width.size), grid.mixture.weight.sum() * grid.mass.sum())
    margin = TAIL * math.sqrt(float(grid.mixture.variance.max()))
    x, y = np.array(centres).T
    reach_x = np.maximum(grid.x[-1] - x, x - grid.x[0])
    reach_y = np.maximum(grid.y[-1] - y, y - grid.y[0])
    some = int(np.searchsorted(half_width, float(np.maximum(reach_x, reach_y).max()) + margin))
    (x, in_column), (y, in_row) = _distinct(x), _distinct(y)  # centres share them
    width = np.sqrt(grid.mixture.variance - grid.tau2)
    together = max(1, _AT_ONCE // (width.size * len(centres) * max(grid.x.size, grid.y.size)))
    for first in range(0, some, together):
        boxes = slice(first, min(first + together, some))
        in_x = _between(x, half_width[boxes], grid.x, width)
        in_y = (_between(y, half_width[boxes], grid.y, width).reshape(-1, grid.y.size) @ grid.mass).reshape(
            width.size, y.size, -1, grid.x.size
        )
        energy[:, boxes] = np.einsum("t,tcbx,tcbx->cb", grid.mixture.weight, in_y[:, in_row], in_x[:, in_column])
    return energy


def _distinct(values: Real) -> tuple[Real, list[int]]:
    """The distinct ones of a few ``values``, and which of these each is."""
    place = {value: n for n, value in enumerate(dict.fromkeys(values.tolist()))}
    return np.array(list(place)), [place[value] for value in values.tolist()]


def _between(centre: Real, half_width: Real, node: Real, width: Real) -> Real:
    """The share of Gaussians about each ``node`` within ``half_width`` of each ``centre``.

    Shape [width, centre, box, node].
    """
    scale = width[:, None, None, None]
    distance, half = (centre[:, None] - node)[:, None] / scale, half_width[:, None] / scale
    return normal_probability(distance - half, distance + half)
