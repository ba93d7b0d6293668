"""The spot on a grid: PSF_G as point masses of a grid, for Gaussians too narrow for the spot's moments [mm].

N(x - x_ray; s^2) is N(x - x_i; s^2 - tau^2) summed over nodes x_i with masses h N(x_i - x_ray; tau^2): the trapezoid
rule for a convolution of two Gaussians, with relative error 2 exp(-2 pi^2 a^2/h^2), a^2 = tau^2 (s^2 - tau^2)/s^2. Rays
are laid on the grid once; all Gaussians of like width, and all cells and boxes, then share it, one axis at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import GeometricalImage, rays_apart, tiles
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]

_LIKE = 8.0  # widths that share a grid differ by less than this factor
_TAU2 = 0.75  # tau^2 over s^2 of the narrowest Gaussian
_TAIL = 6.5  # tau: rays are laid no farther; 1e-10 of a Gaussian lies beyond
_TILE = 12.0  # widths: rays are laid down by tiles of this size


@dataclass(frozen=True, slots=True)
class SpotGrid:
    """Point masses ``mass`` (y, x), adding to 1, at ``y`` and ``x`` [mm]; they stand for PSF_G in Gaussians of the

    ``mixture`` once the variance ``tau2`` [mm^2] is taken from each.
    """

    x: Real
    y: Real
    mass: Real
    tau2: float
    mixture: GaussianMixture


def spot_grids(point: GeometricalImage, mixture: GaussianMixture, spacing: Real) -> Iterator[SpotGrid]:
    """A grid for all Gaussians of like width in a ``mixture``, from rays ``spacing`` [mm] apart for each term."""
    octave = np.floor(0.5 * np.log(mixture.variance / mixture.variance.min(initial=math.inf)) / math.log(_LIKE))
    for this in np.unique(octave):
        some = octave == this
        yield _spot_grid(point, mixture.only(some), spacing[some])


def _spot_grid(point: GeometricalImage, mixture: GaussianMixture, spacing: Real) -> SpotGrid:
    """The grid for Gaussians of like width, from rays ``spacing`` [mm] apart for each term."""
    variance = float(mixture.variance.min())
    tau2 = _TAU2 * variance
    tau = math.sqrt(tau2)
    # each term's a is to the step as its s to its spacing
    step = float(np.min(spacing * np.sqrt(tau2 * (mixture.variance - tau2)) / mixture.variance))
    half = point.mirror_symmetric
    rays = rays_apart(point, float(spacing.min()), half=half)
    x, y = _nodes(rays.x, _TAIL * tau, step, symmetric=half), _nodes(rays.y, _TAIL * tau, step, symmetric=False)
    mass = np.zeros((y.size, x.size))
    for part in tiles(rays, _TILE * math.sqrt(variance)):
        rows, columns = _near(y, part.y, _TAIL * tau), _near(x, part.x, _TAIL * tau)
        in_y = np.exp(-0.5 * ((y[rows, None] - part.y) / tau) ** 2)
        in_x = np.exp(-0.5 * ((x[columns, None] - part.x) / tau) ** 2)
        mass[rows, columns] += (in_y * part.share) @ in_x.T
    mass *= step**2 / (2.0 * math.pi * tau2)
    if half:
        mass = 0.5 * (mass + mass[:, ::-1])
    return SpotGrid(x, y, mass, tau2, mixture)


def _nodes(position: Real, margin: float, step: float, *, symmetric: bool) -> Real:
    """Nodes ``step`` apart that reach ``margin`` beyond the positions; ``symmetric``: about zero."""
    low, high = float(position.min()) - margin, float(position.max()) + margin
    if symmetric:
        high = max(high, -low)
        low = -high
    count = math.ceil((high - low) / step) + 1
    return 0.5 * (low + high) + step * (np.arange(count, dtype=np.float64) - 0.5 * (count - 1))


def _near(nodes: Real, position: Real, margin: float) -> slice:
    """The nodes within ``margin`` of any of the positions."""
    low, high = np.searchsorted(nodes, [position.min() - margin, position.max() + margin])
    return slice(int(low), int(high))
