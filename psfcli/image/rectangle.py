"""The scattered energy in any rectangles: boxes of ensquared energy, single pixels, a whole window [mm]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import TAIL, interval_integrals, moments_to, normal_probability, treatment
from psfcli.image.geometric import GeometricalImage, RayBundle, rays_apart, tiles
from psfcli.surface.mixture import GaussianMixture
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rectangles:
    """From ``x_start`` to ``x_stop`` and ``y_start`` to ``y_stop``, each of shape [rectangle]."""

    x_start: Real
    x_stop: Real
    y_start: Real
    y_stop: Real

    @classmethod
    def squares(cls, centre: tuple[float, float], half_width: Real) -> Rectangles:
        """Squares of ``half_width`` about ``centre``."""
        x, y = centre
        return cls(x - half_width, x + half_width, y - half_width, y + half_width)

    @classmethod
    def together(cls, several: Sequence[Rectangles]) -> Rectangles:
        """All rectangles of ``several``, one after the other."""
        return cls(
            *(
                np.concatenate([getattr(some, edge) for some in several])
                for edge in ("x_start", "x_stop", "y_start", "y_stop")
            )
        )


def scattered_in_rectangles(
    point: GeometricalImage, mixture: GaussianMixture, rectangles: Rectangles, tolerance: Tolerance
) -> Real:
    """The scattered light in each rectangle as a fraction of all light, shape [rectangle].

    PSF_G (x) S of Eq. 44; relative error within ``tolerance.pixel`` and absolute within ``tolerance.ee``.
    """
    energy = np.zeros_like(rectangles.x_start)
    if mixture.weight.size == 0:
        return energy
    how = treatment(point, mixture, tolerance)
    wide = how.order >= 0
    energy += _by_moments(
        GaussianMixture(mixture.weight[wide], mixture.variance[wide]), point, how.order.max(initial=0), rectangles
    )
    halved = point.mirror_symmetric and bool(np.all(rectangles.x_start == -rectangles.x_stop))
    for k in np.flatnonzero(~wide):
        rays = rays_apart(point, float(how.spacing[k]), half=halved)
        energy += mixture.weight[k] * _by_rays(rays, float(mixture.variance[k]) ** 0.5, rectangles)
    return energy


def _by_moments(mixture: GaussianMixture, point: GeometricalImage, order: int, rectangles: Rectangles) -> Real:
    spot = point.spot
    x = interval_integrals(
        rectangles.x_start - spot.centroid_x,
        rectangles.x_stop - spot.centroid_x,
        mixture.variance + spot.rms_x**2,
        order,
    )
    y = interval_integrals(
        rectangles.y_start - spot.centroid_y,
        rectangles.y_stop - spot.centroid_y,
        mixture.variance + spot.rms_y**2,
        order,
    )
    energy: Real = mixture.weight @ np.sum(x * np.tensordot(moments_to(point, order), y, axes=1), axis=0)
    return energy


def _by_rays(rays: RayBundle, width: float, rectangles: Rectangles) -> Real:
    """The energy of a Gaussian of ``width``, carried along by the rays, in each rectangle.

    Rectangles that hold a whole tile of rays with its blur, or miss it, cost nothing.
    """
    margin = TAIL * width
    energy = np.zeros_like(rectangles.x_start)
    for part in tiles(rays, 2.0 * margin):
        left, right = part.x.min() - margin, part.x.max() + margin
        low, high = part.y.min() - margin, part.y.max() + margin
        covers = (rectangles.x_start <= left) & (rectangles.x_stop >= right)
        covers &= (rectangles.y_start <= low) & (rectangles.y_stop >= high)
        energy[covers] += part.share.sum()
        cut = ~covers & (rectangles.x_start < right) & (rectangles.x_stop > left)
        cut &= (rectangles.y_start < high) & (rectangles.y_stop > low)
        some = np.flatnonzero(cut)[:, None]
        in_x = normal_probability(
            (rectangles.x_start[some] - part.x) / width, (rectangles.x_stop[some] - part.x) / width
        )
        in_y = normal_probability(
            (rectangles.y_start[some] - part.y) / width, (rectangles.y_stop[some] - part.y) / width
        )
        energy[cut] += (in_x * in_y) @ part.share
    return energy
