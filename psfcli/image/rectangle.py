"""The scattered energy in any rectangles: boxes of ensquared energy, single pixels, a whole window [mm]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import TAIL, interval_integrals, moment_orders, moments_to, normal_probability, ray_spacing
from psfcli.image.geometric import GeometricalImage
from psfcli.image.spot_grid import SpotGrid, spot_grids
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


def scattered_in_rectangles(
    point: GeometricalImage, mixture: GaussianMixture, rectangles: Rectangles, tolerance: Tolerance, narrow_error: Real
) -> Real:
    """The scattered light in each rectangle as a fraction of all light, shape [rectangle].

    PSF_G (x) S of Eq. 44; relative error within ``tolerance.pixel`` and absolute within ``tolerance.ee``, where terms
    too narrow for moments keep their ``narrow_error``, relative, shape (term,).
    """
    energy = np.zeros_like(rectangles.x_start)
    if mixture.weight.size == 0:
        return energy
    order = moment_orders(point, mixture, tolerance)
    wide, narrow = order >= 0, order < 0
    energy += _by_moments(
        GaussianMixture(mixture.weight[wide], mixture.variance[wide]), point, order.max(initial=0), rectangles
    )
    for grid in spot_grids(
        point,
        GaussianMixture(mixture.weight[narrow], mixture.variance[narrow]),
        ray_spacing(np.sqrt(mixture.variance[narrow]), narrow_error[narrow]),
    ):
        energy += _by_grid(grid, rectangles)
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


def _by_grid(grid: SpotGrid, rectangles: Rectangles) -> Real:
    """The light of the grid's mixture in each rectangle; rectangles that hold all of it cost nothing."""
    margin = TAIL * math.sqrt(float(grid.mixture.variance.max()))
    covers = (rectangles.x_start <= grid.x[0] - margin) & (rectangles.x_stop >= grid.x[-1] + margin)
    covers &= (rectangles.y_start <= grid.y[0] - margin) & (rectangles.y_stop >= grid.y[-1] + margin)
    energy = np.where(covers, grid.mixture.weight.sum() * grid.mass.sum(), 0.0)
    some = ~covers
    for weight, variance in zip(grid.mixture.weight, grid.mixture.variance - grid.tau2, strict=True):
        width = math.sqrt(variance)
        in_x = _between(rectangles.x_start[some], rectangles.x_stop[some], grid.x, width)
        in_y = _between(rectangles.y_start[some], rectangles.y_stop[some], grid.y, width)
        energy[some] += weight * np.einsum("ri,ri->r", in_y @ grid.mass, in_x)
    return energy


def _between(start: Real, stop: Real, node: Real, width: float) -> Real:
    """The probability of landing from ``start`` to ``stop`` for a Gaussian about each node: (rectangles, nodes)."""
    pairs, which = np.unique(np.stack([start, stop]), axis=1, return_inverse=True)
    low, high = (pairs[:, :, None] - node) / width
    probability: Real = normal_probability(low, high)[which.ravel()]
    return probability
