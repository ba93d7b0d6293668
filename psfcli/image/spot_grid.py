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

from psfcli.image.blur import TAIL
from psfcli.image.geometric import GeometricalImage, RayBundle
from psfcli.image.patches import EVERYWHERE, Window, patches_apart
from psfcli.surface.mixture import GaussianMixture

Real = NDArray[np.float64]
Index = NDArray[np.intp]

_LIKE = 8.0  # widths that share a grid differ by less than this factor
_TAU2 = 0.5  # tau^2 over s^2 of the narrowest Gaussian
_TAIL = 6.5  # tau: rays are laid no farther; 1e-10 of a Gaussian lies beyond


@dataclass(frozen=True, slots=True)
class SpotGrid:
    """Point masses ``mass`` (y, x), adding to 1, at ``y`` and ``x`` [mm]; they stand for PSF_G in Gaussians of the

    ``mixture`` once the variance ``tau2`` [mm^2] is taken from each. Rays were ``spacing`` [mm] apart, and nodes are
    ``step``.
    """

    x: Real
    y: Real
    mass: Real
    tau2: float
    mixture: GaussianMixture
    spacing: float
    step: float

    def on_a_line(self, width: float) -> float:
        """The most light on any line along x or y that is ``width`` [mm] wide, as a fraction of all light."""
        nodes = math.ceil(width / self.step)
        most = 0.0
        for axis in (0, 1):
            passed = np.append(0.0, np.cumsum(self.mass.sum(axis=axis)))
            before = np.append(np.zeros(nodes), passed)[: passed.size]
            most = max(most, float(np.max(passed - before)))
        return most


def spot_grids(
    point: GeometricalImage, mixture: GaussianMixture, spacing: Real, window: Window = EVERYWHERE
) -> Iterator[SpotGrid]:
    """A grid for all Gaussians of like width in a ``mixture``, from rays ``spacing`` [mm] apart for each term.

    Only what they send into the ``window`` is asked for.
    """
    octave = np.floor(0.5 * np.log(mixture.variance / mixture.variance.min(initial=math.inf)) / math.log(_LIKE))
    for this in np.unique(octave):
        some = octave == this
        yield _spot_grid(point, mixture.only(some), spacing[some], window)


def _spot_grid(point: GeometricalImage, mixture: GaussianMixture, spacing: Real, window: Window) -> SpotGrid:
    """The grid for Gaussians of like width, from rays ``spacing`` [mm] apart for each term."""
    tau2 = _TAU2 * float(mixture.variance.min())
    reach = _TAIL * math.sqrt(tau2)
    # each term's a is to the step as its s to its spacing
    step = float(np.min(spacing * np.sqrt(tau2 * (mixture.variance - tau2)) / mixture.variance))
    half = point.mirror_symmetric
    margin = TAIL * math.sqrt(float(mixture.variance.max()))
    x_start, x_stop, y_start, y_stop = (w + s * margin for w, s in zip(window, (-1, 1, -1, 1), strict=True))
    if half:
        x_stop = max(x_stop, -x_start)
        x_start = -x_stop
    spot = point.spot
    x = _nodes(max(spot.x_min, x_start) - reach, min(spot.x_max, x_stop) + reach, step, symmetric=half)
    y = _nodes(max(spot.y_min, y_start) - reach, min(spot.y_max, y_stop) + reach, step, symmetric=False)
    mass = np.zeros((y.size, x.size))
    for rays in patches_apart(point, float(spacing.min()), half=half, window=(x_start, x_stop, y_start, y_stop)):
        _lay(mass, rays, x, y, tau2, reach)
    mass *= step**2 / (2.0 * math.pi * tau2)
    if half:
        mass = 0.5 * (mass + mass[:, ::-1])
    return SpotGrid(x, y, mass, tau2, mixture, float(spacing.min()), step)


def _nodes(low: float, high: float, step: float, *, symmetric: bool) -> Real:
    """Nodes ``step`` apart from ``low`` to ``high``; ``symmetric``: about zero."""
    if symmetric:
        high = max(high, -low)
        low = -high
    count = max(math.ceil((high - low) / step), 0) + 1
    return 0.5 * (low + high) + step * (np.arange(count, dtype=np.float64) - 0.5 * (count - 1))


def _lay(mass: Real, rays: RayBundle, x: Real, y: Real, tau2: float, reach: float) -> None:
    """Add patches of rays (patch, ray) to the nodes within ``reach`` of them, each by exp(-distance^2/2 tau2)."""
    columns, in_x = _bells(rays.x, x, tau2, reach)
    rows, in_y = _bells(rays.y, y, tau2, reach)
    blocks = np.matmul(in_y * rays.share[:, None, :], in_x.transpose(0, 2, 1))
    height, width = blocks.shape[1:]
    for row, column, block in zip(rows.tolist(), columns.tolist(), blocks, strict=True):
        mass[row : row + height, column : column + width] += block


def _bells(position: Real, nodes: Real, tau2: float, reach: float) -> tuple[Index, Real]:
    """The first node near each patch of ``position`` (patch, ray), and exp(-distance^2/2 tau2): (patch, node, ray).

    As many nodes for each patch as the largest has within ``reach``.
    """
    first = np.searchsorted(nodes, position.min(axis=1) - reach)
    count = int(np.max(np.searchsorted(nodes, position.max(axis=1) + reach) - first, initial=0))
    first = np.minimum(first, nodes.size - count)
    near = nodes[first[:, None] + np.arange(count)]
    return first, np.exp((near[:, :, None] - position[:, None, :]) ** 2 * (-0.5 / tau2))
