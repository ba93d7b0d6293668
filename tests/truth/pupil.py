"""Means over the lit pupil of what varies fast in places of the image, by cells as fine as those places ask for."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from .geometry import ray_error
from .system import TruthSystem

Density = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
Scales = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

RELATIVE, FAINTEST = 1e-9, 1e-35  # of the mean
_WIDEST = 2.5  # a cell's light over the scale of the density, to begin with
_MOST_CELLS = 200_000
_CELLS_AT_ONCE = 8  # what they see fits into a cache
_NODE, _GAUSS = np.polynomial.legendre.leggauss(8)
# the last four of the Legendre polynomials that eight nodes can tell, orthonormal, times the weights
_LAST = (np.polynomial.legendre.legvander(_NODE, 7) * np.sqrt(np.arange(8) + 0.5) * _GAUSS[:, None]).T[4:]


def pupil_mean(system: TruthSystem, density: Density, scales: Scales, absolute: float = FAINTEST) -> float:
    """The mean over the lit pupil of ``density`` (eps_x, eps_y, error).

    The density varies over distances ``scales`` (eps_x, eps_y) [mm], and may err by ``error`` at any ray: a tenth of
    what the mean may, as a ray per cell foretells it.

    Product Gauss rules of degree 15 on cells of rho x azimuth, halved until what they doubt of themselves is, all
    together, below ``RELATIVE`` of the whole or ``absolute``. Raises ArithmeticError beyond ``_MOST_CELLS``.
    """
    cells, settled = _first_cells(system, scales), 0.0
    r0, r1, f0, f1 = cells.T
    rho, phi = 0.5 * (r0 + r1), 0.5 * (f0 + f1)
    shares = rho * (r1 - r0) * (f1 - f0)
    foretold = shares @ density(*ray_error(system, rho * np.cos(phi), rho * np.sin(phi)), 0.1 * absolute) / shares.sum()
    error = 0.1 * max(RELATIVE * float(foretold), absolute)
    while len(cells):
        if len(cells) > _MOST_CELLS:
            raise ArithmeticError(f"{len(cells)} cells of the pupil do not suffice")
        some = np.array_split(cells, math.ceil(len(cells) / _CELLS_AT_ONCE))
        parts = [_rule(system, density, error, part) for part in some]
        value, *doubts = (np.concatenate(part) for part in zip(*parts, strict=True))
        doubt = doubts[0] + doubts[1]
        whole = settled + value.sum()
        least_first = np.argsort(doubt)
        poor = np.empty(len(cells), dtype=bool)
        poor[least_first] = np.cumsum(doubt[least_first]) > max(RELATIVE * abs(whole), absolute)
        settled += value[~poor].sum()
        cells = _halved(cells[poor], (doubts[0] > doubts[1])[poor])
    return float(settled)


def _rule(
    system: TruthSystem, density: Density, error: float, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cells' shares of the mean, and their errors by the rules in rho and in azimuth.

    The eight Legendre coefficients fall like a geometric series where the density is smooth on the cell: the error, of
    the order of the sixteenth, is some 4.7 of such ratios below the last two. Three are taken.
    """
    first, last = azimuths(system)
    area = 0.5 * (1.0 - system.obscuration**2) * (last - first)
    rho, phi = _spread(cells, _NODE)
    ex, ey = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
    found = rho * density(ex.ravel(), ey.ravel(), error).reshape(ex.shape)
    share = 0.25 * (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2]) / area
    doubts = []
    for values in (found, found.transpose(0, 2, 1)):
        size = np.sqrt((_LAST @ values) ** 2 @ _GAUSS)  # of the coefficients in this direction, [cell, 4]
        before, end = np.hypot(size[:, 0], size[:, 1]), np.hypot(size[:, 2], size[:, 3])
        doubts.append(2.0 * share * end * np.minimum(1.0, end / (before + 1e-300)) ** 3)
    return share * (found @ _GAUSS @ _GAUSS), doubts[0], doubts[1]


def azimuths(system: TruthSystem) -> tuple[float, float]:
    """From where to where the pupil is lit [rad]."""
    return system.sector or (0.0, 2.0 * math.pi)


def _spread(cells: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rho, phi) [cell, rho, phi] of a grid over each cell, its places from -1 to 1."""
    r0, r1, f0, f1 = cells.T[..., None]
    rho, phi = (0.5 * (low + high + (high - low) * place) for low, high in ((r0, r1), (f0, f1)))
    return rho[:, :, None], phi[:, None, :]


def _first_cells(system: TruthSystem, scales: Scales) -> np.ndarray:
    """Cells (rho0, rho1, phi0, phi1) [n, 4] of the lit pupil, the light of each about as wide as ``scales`` or less.

    Halved across rho or azimuth, whichever spreads its light over more scales.
    """
    first, last = azimuths(system)
    r, f = np.linspace(system.obscuration, 1.0, 3), np.linspace(first, last, max(2, round(1.3 * (last - first))) + 1)
    cells = np.array([(*rho, *phi) for rho in pairwise(r) for phi in pairwise(f)])
    fine = []
    while len(cells):
        rho, phi = _spread(cells, np.linspace(-1.0, 1.0, 5))
        rays = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
        spread = np.zeros((2, len(cells)))
        for place, scale in zip(rays, scales(*rays), strict=True):
            narrow = scale.min(axis=(1, 2))
            for i, axis in enumerate((1, 2)):
                length = np.abs(np.diff(place, axis=axis)).sum(axis=axis).max(axis=1)
                spread[i] = np.maximum(spread[i], length / narrow)
        wide = spread.max(axis=0) > _WIDEST
        fine.append(cells[~wide])
        cells = _halved(cells[wide], (spread[0] > spread[1])[wide])
        if len(cells) > _MOST_CELLS:
            raise ArithmeticError(f"more than {_MOST_CELLS} cells of the pupil to begin with")
    return np.concatenate(fine)


def _halved(cells: np.ndarray, across_rho: np.ndarray) -> np.ndarray:
    """Both halves of each cell, cut across rho where told and else across azimuth."""
    first, second = cells.copy(), cells.copy()
    for low, some in ((0, across_rho), (2, ~across_rho)):
        middle = cells[some, low : low + 2].mean(axis=1)
        first[some, low + 1] = middle
        second[some, low] = middle
    return np.concatenate([first, second])
