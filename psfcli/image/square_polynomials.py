"""The scattered energy in squares by even polynomials of where rays land [mm].

A square of half width w about c holds f(x) f(y) of a Gaussian of width s about a ray at c + (x, y),

    f(x; w, s) = Phi((x + w)/s) - Phi((x - w)/s),

which is even and entire: for |x| <= L it is a short series of Chebyshev polynomials T_2a(x/L) unless s is far below L.
With its coefficients C_a the square holds, of a whole spot and several Gaussians,

    sum_ab M_ab R_ab(w),   R_ab = sum_t weight_t C_a(w, s_t) C_b(w, s_t),   M_ab = E[T_2a(x/L) T_2b(y/L)].

All spots of like extent share the table R; a spot adds M, a sum over rays as close as the Gaussians ask for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.image.blur import ray_error
from psfcli.image.geometric import GeometricalImage
from psfcli.image.patches import rays_apart
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]
Centres = Sequence[tuple[float, float]]

_COUNTS = np.arange(4, 49)  # of polynomials along an axis: more cost more than rays on a grid do
_LARGEST_TABLE, _BOXES_AT_ONCE = 1 << 22, 512  # numbers of a table, and squares whose series are held at once
_SHARE = 0.03  # of the tolerance, for what the series leave out: a digit costs two polynomials
_LOOSEST = 1e-2  # of the scattered light, where more is allowed: what small squares hold is no noise
# radii and azimuths of the rays, and per digit: two calculations that are to judge each other take different ones
_FEWEST_RAYS, _RAYS_PER_DIGIT = 6.0, 2.0
_RAY_SHARE = 0.3  # for what rays leave out
_CLOSEST, _FARTHEST = 0.5, 4.4  # widths that rays are apart, at which they err by 1e-34 and by 1
_SPACINGS = 200


@dataclass(frozen=True, slots=True)
class PolynomialResponse:
    """What squares hold of all Gaussians of a mixture but the ``first``, by polynomials on |x|, |y| <= ``extent`` [mm].

    ``response`` (count, count, box) is R. Rays are to be ``spacing`` [mm] apart, and on ``fewest`` radii and azimuths.
    """

    extent: float
    first: int
    spacing: float
    fewest: int
    response: Real

    def energy(self, point: GeometricalImage, centres: Centres) -> Real:
        """The light in each square about each of the ``centres``: shape [centre, box]."""
        count, _, boxes = self.response.shape
        if count == 0:
            return np.zeros((len(centres), boxes))
        moments = polynomial_moments(point, centres, self.extent, count, self.spacing, self.fewest)
        energy: Real = moments.reshape(len(centres), -1) @ self.response.reshape(-1, boxes)
        return energy


def common_extent(point: GeometricalImage, centres: Centres, least: float) -> float:
    """How far rays land from any of the ``centres`` along x or y, up to the next power of the square root of 2 [mm].

    No less than the ``least`` [mm].
    """
    spot, (x, y) = point.spot, np.array(centres).T
    farthest = float(np.max([spot.x_max - x, x - spot.x_min, spot.y_max - y, y - spot.y_min]))
    return 2.0 ** (0.5 * math.ceil(2.0 * math.log2(max(farthest, least))))


def polynomial_response(
    mixture: GaussianMixture, half_width: Real, extent: float, tolerance: float
) -> PolynomialResponse:
    """The table for squares of ``half_width`` [mm] and spots of an ``extent`` [mm].

    It begins with the first Gaussian, by increasing variance, for which _COUNTS suffice; fewer of them where there are
    very many squares. All together err by a part of the ``tolerance``, of all light.
    """
    weight, width, boxes = mixture.weight, np.sqrt(mixture.variance), half_width.size
    whole = float(np.abs(weight).sum())
    counts = _COUNTS[_COUNTS**2 * boxes <= _LARGEST_TABLE]
    left_out = 2.0 * np.abs(weight)[:, None] * truncation_error(extent / width[:, None], counts)
    together = np.cumsum(left_out[::-1], axis=0)[::-1]  # of a Gaussian and all wider ones
    allowed = _SHARE * min(tolerance, _LOOSEST * whole)
    first = int(np.count_nonzero(together[:, -1] > allowed))
    if first == weight.size:
        return PolynomialResponse(extent, first, math.inf, 0, np.zeros((0, 0, boxes)))
    enough = counts[np.argmax(together[first:] <= allowed, axis=1)]
    weight, width, count = weight[first:], width[first:], int(enough[0])
    steps = np.minimum(2 ** np.ceil(np.log2(enough)).astype(np.intp), count)  # few serve the many wide ones
    response = np.empty((count, count, boxes))
    for start in range(0, boxes, _BOXES_AT_ONCE):
        some_boxes = slice(start, start + _BOXES_AT_ONCE)
        series = np.zeros((weight.size, half_width[some_boxes].size, count))
        for few in np.unique(steps):
            some = steps == few
            series[some, :, :few] = _series(width[some], half_width[some_boxes], extent, int(few))
        by_box = series.transpose(1, 2, 0)
        response[..., some_boxes] = np.moveaxis((by_box * weight) @ by_box.swapaxes(1, 2), 0, 2)
    spacing = _spacing(np.abs(weight), width, _RAY_SHARE * tolerance)
    digits = -math.log10(min(tolerance / whole, _LOOSEST))
    return PolynomialResponse(extent, first, spacing, math.ceil(_FEWEST_RAYS + _RAYS_PER_DIGIT * digits), response)


def _series(width: Real, half_width: Real, extent: float, count: int) -> Real:
    """C_a of each Gaussian and square for a < ``count``, by interpolation: shape (width, half_width, count)."""
    angle = 0.5 * math.pi * (np.arange(count) + 0.5) / count
    along, across, each = extent * np.cos(angle), half_width[:, None], width[:, None, None]
    inside = special.ndtr((along + across) / each) - special.ndtr((along - across) / each)
    series: Real = inside @ np.cos(2.0 * np.outer(angle, np.arange(count))) * (2.0 / count)
    series[..., 0] *= 0.5
    return series


def _spacing(weight: Real, width: Real, tolerance: float) -> float:
    """How far apart rays may land [mm] for all Gaussians to err by no more than the ``tolerance`` together."""
    spacing = np.geomspace(_CLOSEST * width[0], _FARTHEST * width[-1], _SPACINGS)
    return float(spacing[np.count_nonzero(ray_error(width, spacing[:, None]) @ weight <= tolerance) - 1])


def truncation_error(ratio: Real, count: Real | NDArray[np.intp]) -> Real:
    """How far f is from its interpolation by ``count`` even polynomials, for Gaussians of width extent/``ratio``.

    At most 4 M r^(2 - 2 count)/(r^2 - 1) for any r > 1, M the largest |f| on the ellipse of semi-axes
    L (r + 1/r)/2 and L (r - 1/r)/2: a Gaussian grows by exp(y^2/(2 s^2)) at most where it is taken at a distance y from
    the real axis. With r = e^v, at the v of nearly the least of that.
    """
    v = 0.5 * np.arcsinh(4.0 * count / ratio**2)
    error: Real = 4.0 * np.exp(0.5 * (ratio * np.sinh(v)) ** 2 - 2.0 * (count - 1) * v) / np.expm1(2.0 * v)
    return error


def polynomial_moments(
    point: GeometricalImage, centres: Centres, extent: float, count: int, spacing: float, fewest: int
) -> Real:
    """E[T_2a(dx/extent) T_2b(dy/extent)] about each of the ``centres``: shape (centre, count, count).

    From rays ``spacing`` [mm] apart, on ``fewest`` radii and azimuths or more.
    """
    moments = np.zeros((len(centres), count, count))
    x, y = np.array(centres).T
    half = point.mirror_symmetric and not x.any()
    x = x[:1] if np.all(x == x[0]) else x  # fields along y share it
    for rays in rays_apart(point, spacing, fewest, half=half):
        in_x, in_y = (
            _even_chebyshev((landing - of[:, None]) / extent, count) for landing, of in ((rays.x, x), (rays.y, y))
        )
        in_x *= rays.share
        moments += in_x @ in_y.swapaxes(1, 2)
    return moments


def _even_chebyshev(place: Real, count: int) -> Real:
    """T_0, T_2, ... at ``place`` (centre, ray): shape (centre, count, ray)."""
    twice = 4.0 * place**2 - 2.0  # T_2a(x) = T_a(2 x^2 - 1)
    out = np.empty((len(place), count, place.shape[1]))
    out[:, 0] = 1.0
    np.multiply(0.5, twice, out=out[:, 1])
    for a in range(2, count):
        np.multiply(twice, out[:, a - 1], out=out[:, a])
        out[:, a] -= out[:, a - 2]
    return out
