"""Rays through the pupil, close together where it matters and far apart elsewhere [mm].

The pupil is cut into cells of rho and azimuth, which are halved until each lands within the spacing asked for where
it lands; Gauss's rule in each.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from psfcli.image.geometric import GeometricalImage, RayBundle, ray_fans
from psfcli.image.quadrature import gauss_legendre

Real = NDArray[np.float64]

_FIRST_RADII, _FIRST_AZIMUTHS = 1, 8
_MOST_CELLS = 200_000
_SEEN_AT = np.linspace(-1.0, 1.0, 5)  # of a cell, either way: rays that turn back hide from fewer


def graded_rays(image: GeometricalImage, spacing: Callable[[Real, Real], Real], nodes: int) -> RayBundle:
    """Rays about ``spacing(x, y)`` [mm] apart where they land at (x, y), counted from the Gaussian image point.

    ``nodes`` of each cell, either way, in cells at most ``nodes`` - 1 spacings wide by how fast rays move at most.
    """
    start, stop = image.telescope.pupil.sector
    inner = image.telescope.pupil.obscuration
    r = np.linspace(inner, 1.0, _FIRST_RADII + 1)
    a = np.linspace(start, stop, _FIRST_AZIMUTHS + 1)
    cells = np.array([(*r[i : i + 2], *a[j : j + 2]) for i in range(_FIRST_RADII) for j in range(_FIRST_AZIMUTHS)])
    done: list[Real] = []
    while cells.size:
        x, y = _landing(image, cells, _SEEN_AT)
        along, around = (_fastest_path(x, y, axis) for axis in (1, 2))
        allowed = (nodes - 1) * spacing(x, y).min(axis=(1, 2))
        fits = (np.maximum(along, around) <= allowed) | (sum(len(d) for d in done) + len(cells) > _MOST_CELLS)
        done.append(cells[fits])
        cells, radial = cells[~fits], (along > around)[~fits]
        middle = np.where(radial, 0.5 * (cells[:, 0] + cells[:, 1]), 0.5 * (cells[:, 2] + cells[:, 3]))
        low, high = cells.copy(), cells.copy()
        low[np.arange(len(cells)), np.where(radial, 1, 3)] = middle
        high[np.arange(len(cells)), np.where(radial, 0, 2)] = middle
        cells = np.concatenate([low, high])
    cells = np.concatenate(done)
    node, weight = gauss_legendre(nodes)
    x, y = _landing(image, cells, node)
    area = 2.0 * (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2]) / ((1.0 - inner**2) * (stop - start))
    share = (
        area[:, None, None] * _between(cells[:, :2], node)[:, :, None] * np.multiply.outer(0.5 * weight, 0.5 * weight)
    )
    return RayBundle(share.ravel(), x.ravel(), y.ravel())


def _fastest_path(x: Real, y: Real, axis: int) -> Real:
    """How far rays would move across each cell along an ``axis`` if they moved everywhere as fast as anywhere in it.

    The path itself tells too little: nodes are spread evenly in the pupil and not in the image.
    """
    steps = np.hypot(np.diff(x, axis=axis), np.diff(y, axis=axis))
    path: Real = steps.shape[axis] * steps.max(axis=(1, 2))
    return path


def _landing(image: GeometricalImage, cells: Real, node: Real) -> tuple[Real, Real]:
    """Landing points of the product nodes, -1 to 1 across each cell: x and y of shape (cell, radius, azimuth)."""
    rho, azimuth = _between(cells[:, :2], node)[:, :, None], _between(cells[:, 2:], node)
    fans = ray_fans(image.telescope, image.field, azimuth.ravel())
    x, y = ((((f[3] * rho + f[2]) * rho + f[1]) * rho + f[0]) for f in (c.reshape(4, -1, 1, node.size) for c in fans))
    return x, y


def _between(bounds: Real, node: Real) -> Real:
    """Points at ``node``, -1 to 1, between each pair of ``bounds`` (cell, 2): shape (cell, node)."""
    low, high = bounds.T[:, :, None]
    points: Real = low + 0.5 * (high - low) * (node + 1.0)
    return points
