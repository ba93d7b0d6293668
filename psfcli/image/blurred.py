"""The light of ray fans blurred by a Gaussian far narrower than the spot, in squares about the origin [mm].

Along a fan the blurred light of a square is Int P_x(x(rho)) P_y(y(rho)) d(rho^2), P the probability that the Gaussian's
coordinate falls between the square's edges: 1 inside and 0 outside but for the few widths about an edge, where Gauss's
rule sees a smooth function however the fan crosses, grazes or misses the edge. Without ray noise, and at a cost that
does not grow as the Gaussian narrows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import FEW_TERMS, normal_probability
from psfcli.image.crossings import Branches, cubic, root_between, stretches
from psfcli.image.quadrature import gauss_legendre
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class BlurredEdge:
    """How far the blur of an edge is followed, in ``widths`` of the Gaussian on either side, Gauss's ``nodes``

    across it.
    """

    widths: float
    nodes: int


_EDGE = BlurredEdge(5.0, 20)  # light good to 1e-7 of the whole
_STRICT_EDGE = BlurredEdge(6.0, 28)  # to 1e-9
_TERMS_PER_DIGIT = 2.0


def blurred_edge(tolerance: Real, mixture: GaussianMixture) -> BlurredEdge:
    """What the light of a ``mixture`` takes to be within the least ``tolerance``, of all light."""
    return _STRICT_EDGE if np.any(tolerance < 1e-6 * mixture.weight.sum()) else _EDGE


def terms_for(tolerance: Real, mixture: GaussianMixture) -> int:
    """How many Gaussians stand for all of a ``mixture`` within the least ``tolerance``, of all light.

    Measured: the rule of ``fewer_terms`` gains half a digit by each, for widths from the spot's down to a hundredth.
    """
    digits = math.log10(max(float(mixture.weight.sum() / tolerance.min()), 1.0))
    return max(FEW_TERMS, math.ceil(_TERMS_PER_DIGIT * digits))


def blurred_light_in_squares(
    fans_x: Real, fans_y: Real, inner: float, half_width: Real, width: float, edge: BlurredEdge
) -> Real:
    """The share of each fan's light, blurred by ``width`` [mm], in squares of ``half_width`` about the origin.

    Shape (azimuths, boxes). ``fans_x``, ``fans_y`` (4, azimuths) are the landing points from rho = ``inner`` to 1.
    """
    branches = Branches.of(fans_x, inner), Branches.of(fans_y, inner)
    blur = edge.widths * width
    farthest = np.maximum(*(np.abs(b.value).max(axis=0) for b in branches))
    closest = np.maximum(*(b.closest() for b in branches))
    light = (farthest[:, None] <= half_width - blur).astype(np.float64)
    fan, box = np.nonzero((light == 0.0) & (closest[:, None] < half_width + blur))
    if fan.size == 0:
        return light
    w = half_width[box]
    edges = np.stack([-w - blur, np.minimum(-w + blur, 0.0), np.maximum(w - blur, 0.0), w + blur])
    cuts = [_cuts(b, fan, edges) for b in branches]
    start, stop, which = stretches(
        np.concatenate([pair for pair, _ in cuts]), np.concatenate([rho for _, rho in cuts]), fan.size, inner
    )
    middle = 0.5 * (start + stop)
    of, half = fan[which], w[which]
    distance = np.maximum(np.abs(cubic(fans_x[:, of], middle)), np.abs(cubic(fans_y[:, of], middle)))
    share = (stop - start) * (stop + start)
    share[distance >= half + blur] = 0.0
    smooth = np.flatnonzero((distance > half - blur) & (distance < half + blur))
    node, weight = gauss_legendre(edge.nodes)
    span = 0.5 * (stop - start)[smooth, None]
    rho = middle[smooth, None] + span * node
    inside = 2.0 * span * weight * rho
    for fans in (fans_x, fans_y):
        position = cubic(fans[:, of[smooth], None], rho)
        side = half[smooth, None]
        inside *= normal_probability((-side - position) / width, (side - position) / width)
    share[smooth] = inside.sum(axis=1)
    light[fan, box] = np.bincount(which, share, fan.size) / (1.0 - inner**2)
    return light


def _cuts(branches: Branches, fan: Index, edges: Real) -> tuple[Index, Real]:
    """Where the fans ``fan`` (pairs,) cross their own ``edges`` (4, pairs): indices of pairs, and pupil radii."""
    before, after = branches.value[:-1, fan], branches.value[1:, fan]
    low, high = np.minimum(before, after)[None], np.maximum(before, after)[None]
    edge, branch, pair = np.nonzero((low < edges[:, None]) & (edges[:, None] < high))
    cubics = branches.fans[:, fan[pair]]
    cubics[0] -= edges[edge, pair]
    return pair, root_between(cubics, branches.rho[branch, fan[pair]], branches.rho[branch + 1, fan[pair]])
