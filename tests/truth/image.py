"""The composite image of one field in many rectangles: the quick judge, for images whose halo is tabled once.

As ``ensquared``, an energy is the unscattered light of the rectangle plus that of S about every ray. The scattered
light of a ray at (x, y) in a rectangle, by where the ray is (c: narrowest knee, gap: distance to the rectangle):

- rectangle small against hypot(gap, c): a product Gauss rule of S, to relative accuracy;
- ray inside, or no farther outside than c/2: (1/2 pi) closed Int [energy within R] dphi along the edges;
- ray outside: - (1/2 pi) closed Int [energy beyond R] dphi, and where that cancels, the rectangle in quarters.

The pupil is integrated by cells of rho x azimuth with product Gauss rules, quartered until they stand.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .geometry import ray_error
from .radial import RadialScatter, radial_scatter
from .specular import specular_energy
from .system import TruthSystem, specular_weight

Window = tuple[float, float, float, float]
Density = Callable[[np.ndarray, np.ndarray], np.ndarray]

RELATIVE, FAINTEST = 1e-8, 1e-35  # of each rectangle's scattered light: a core missed by all rays shows in its tail
_UNSCATTERED = 3e-10  # the tolerance of unscattered light, of all light
_MOST_CELLS = 100_000
_TABLE = 1e-12  # relative error of the tabled energies
_CANCELLED = 1e-10  # the most of it that may be left in what rays outside see
_EDGE_PIECE = 1.0
_RAYS_AT_ONCE = 20_000
_RAYS_PER_CORE = 4.0  # cores between neighbouring rays, to begin with: what is narrow shows


class Image:
    """One system's image; ``reach`` [mm] bounds the distances between its rays and any corner asked for.

    Energies are fractions of all light: scattered light to 1e-8 of itself, unscattered to 1e-9.
    """

    def __init__(self, system: TruthSystem, reach: float) -> None:
        self.system = system
        self.specular = specular_weight(system)
        self.halo: RadialScatter | None = None
        if system.surfaces:
            self.halo = radial_scatter(system, reach)
            self._core = min(system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms)
        rho, phi = np.linspace(system.obscuration, 1.0, 65)[:, None], np.linspace(*_azimuths(system), 721)
        ex, ey = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
        self._fan = ex.ravel(), ey.ravel()
        self.bounds = float(ex.min()), float(ex.max()), float(ey.min()), float(ey.max())
        self.is_point = self.bounds[1] == self.bounds[0] and self.bounds[3] == self.bounds[2]

    def touches(self, window: Window) -> bool:
        """Whether unscattered light falls into the window: a ray of a fan does, or there is energy."""
        x, y = self._fan
        x0, x1, y0, y1 = window
        return bool(np.any((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))) or self.unscattered(window) > 0.0

    def unscattered(self, window: Window) -> float:
        """Fraction of PSF_G in the window."""
        x0, x1, y0, y1 = self.bounds
        # the extremes of a fine fan of rays, and more than the fan may have missed
        slack = 1e-2 * max(x1 - x0, y1 - y0)
        x0, x1, y0, y1 = x0 - slack, x1 + slack, y0 - slack, y1 + slack
        if x0 > window[0] and x1 < window[1] and y0 > window[2] and y1 < window[3]:
            return 1.0
        if x1 < window[0] or x0 > window[1] or y1 < window[2] or y0 > window[3]:
            return 0.0
        return specular_energy(self.system, *window, _UNSCATTERED / max(self.specular, 1e-3))

    def scattered(self, window: Window, absolute: float = FAINTEST) -> float:
        """Energy of PSF_G (x) S in the window, relative error ``RELATIVE`` or ``absolute`` error."""
        if self.halo is None:
            return 0.0
        if self.is_point:
            x, y = (np.array([self.bounds[i]]) for i in (0, 2))
            return float(self._about(window, x, y)[0])
        return pupil_mean(self.system, lambda x, y: self._about(window, x, y), _RAYS_PER_CORE * self._core, absolute)

    def energy(self, window: Window, absolute: float = FAINTEST) -> float:
        """Fraction of all light in the window (x0, x1, y0, y1) [mm], within ``RELATIVE`` of it or ``absolute``."""
        lit = self.specular * self.unscattered(window) if self.specular > 1e-18 else 0.0
        return lit + self.scattered(window, max(absolute, min(RELATIVE * lit, _UNSCATTERED)))

    def square(self, half_width: float, centre: tuple[float, float] = (0.0, 0.0)) -> float:
        """Ensquared energy: the square of ``half_width`` [mm] about ``centre`` [mm]."""
        cx, cy = centre
        return self.energy((cx - half_width, cx + half_width, cy - half_width, cy + half_width), _UNSCATTERED)

    def _about(self, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The energy of S about each ray in the window."""
        assert self.halo is not None
        x0, x1, y0, y1 = window
        gap = np.hypot(np.maximum(0.0, np.maximum(x0 - x, x - x1)), np.maximum(0.0, np.maximum(y0 - y, y - y1)))
        scale = np.hypot(gap, self._core)
        small = max(x1 - x0, y1 - y0) < 0.5 * scale
        away = ~small & (gap > 0.5 * self._core)
        near = ~small & ~away
        result = np.empty_like(x)
        if small.any():
            result[small] = _product_rule(self.halo, window, x[small], y[small])
        if near.any():
            result[near] = _along_edges(self.halo.inside, window, x[near], y[near], 0.3 * scale[near])
        if away.any():
            beyond = self.halo.outside(gap[away] ** 2)
            result[away] = -_along_edges(self.halo.outside, window, x[away], y[away], gap[away])
            lost = np.zeros_like(away)
            # an error that is small against the mean of these rays, of like weights, is small in the whole
            lost[away] = _TABLE * beyond > _CANCELLED * np.maximum(np.abs(result[away]), result.mean())
            if lost.any():
                result[lost] = sum(self._about(part, x[lost], y[lost]) for part in _in_quarters(window))
        return result


def _azimuths(system: TruthSystem) -> tuple[float, float]:
    return system.sector or (0.0, 2.0 * math.pi)


def pupil_mean(system: TruthSystem, density: Density, apart: float = np.inf, absolute: float = FAINTEST) -> float:
    """The mean over the lit pupil of ``density`` (eps_x, eps_y) [any unit], smooth in the image plane.

    To begin with, rays land about ``apart`` [mm] from each other or nearer.

    Cells are quartered until cells and their quarters agree, all together, within ``RELATIVE`` of the whole or
    ``absolute``. The rule, of degree 13, then errs by far less. Raises ArithmeticError beyond ``_MOST_CELLS``.
    """
    inner, (first, last) = system.obscuration, _azimuths(system)
    node, gauss = np.polynomial.legendre.leggauss(7)
    area = 0.5 * (1.0 - inner**2) * (last - first)

    def rule(cells: np.ndarray) -> np.ndarray:  # cells [n, 4] of (rho0, rho1, phi0, phi1); their shares of the mean
        values = np.empty(len(cells))
        for i in range(0, len(cells), _RAYS_AT_ONCE // 49):
            r0, r1, f0, f1 = cells[i : i + _RAYS_AT_ONCE // 49].T
            rho = 0.5 * (r1 + r0)[:, None, None] + 0.5 * (r1 - r0)[:, None, None] * node[:, None]
            phi = 0.5 * (f1 + f0)[:, None, None] + 0.5 * (f1 - f0)[:, None, None] * node
            ex, ey = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
            found = rho * density(ex.ravel(), ey.ravel()).reshape(ex.shape)
            values[i : i + _RAYS_AT_ONCE // 49] = (
                0.25 * (r1 - r0) * (f1 - f0) / area * np.einsum("i,j,nij->n", gauss, gauss, found)
            )
        return values

    cells = _first_cells(system, 7.0 * apart)
    coarse, settled = rule(cells), 0.0
    while len(cells):
        if len(cells) > _MOST_CELLS:
            raise ArithmeticError(f"{len(cells)} cells of the pupil do not suffice")
        quarters = _quartered(cells)
        fine = rule(quarters)
        together = fine.reshape(-1, 4).sum(axis=1)
        whole = settled + together.sum()
        doubt = np.abs(together - coarse)
        least_first = np.argsort(doubt)
        poor = np.empty(len(cells), dtype=bool)
        poor[least_first] = np.cumsum(doubt[least_first]) > max(RELATIVE * abs(whole), absolute)
        settled += together[~poor].sum()
        poor4 = np.repeat(poor, 4)
        cells, coarse = quarters[poor4], fine[poor4]
    return float(settled)


def _first_cells(system: TruthSystem, size: float) -> np.ndarray:
    """Cells (rho0, rho1, phi0, phi1) [n, 4] of the lit pupil, the light of each about ``size`` [mm] wide or less."""
    first, last = _azimuths(system)
    rho, phi = np.linspace(system.obscuration, 1.0, 17)[:, None], np.linspace(first, last, 97)
    fan = np.array(ray_error(system, rho * np.cos(phi), rho * np.sin(phi)))
    lengths = [np.hypot(*np.diff(fan, axis=axis)).sum(axis=axis - 1).max() for axis in (1, 2)]
    rings, spokes = max(2, math.ceil(lengths[0] / size)), max(1, math.ceil(lengths[1] / size))
    spokes = max(spokes, round(8.0 * (last - first) / (2.0 * math.pi)))
    r, f = np.linspace(system.obscuration, 1.0, rings + 1), np.linspace(first, last, spokes + 1)
    return np.array([(r[i], r[i + 1], f[j], f[j + 1]) for i in range(rings) for j in range(spokes)])


def _quartered(cells: np.ndarray) -> np.ndarray:
    """The four quarters of each cell, one cell's after another's."""
    r0, r1, f0, f1 = cells.T
    r, f = 0.5 * (r0 + r1), 0.5 * (f0 + f1)
    quarters = [(r0, r, f0, f), (r0, r, f, f1), (r, r1, f0, f), (r, r1, f, f1)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 4)


def _product_rule(halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x0, x1, y0, y1 = window
    node, gauss = np.polynomial.legendre.leggauss(6)
    dx = 0.5 * (x1 + x0 + (x1 - x0) * node)[None, :, None] - x
    dy = 0.5 * (y1 + y0 + (y1 - y0) * node)[:, None, None] - y
    return np.einsum("i,j,ijk->k", gauss, gauss, halo.psf(dx * dx + dy * dy)) * (x1 - x0) * (y1 - y0) / 4.0


def _in_quarters(window: Window) -> list[Window]:
    x0, x1, y0, y1 = window
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    return [(x0, x, y0, y), (x, x1, y0, y), (x0, x, y, y1), (x, x1, y, y1)]


def _along_edges(
    energy: Callable[[np.ndarray], np.ndarray], window: Window, x: np.ndarray, y: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """(1/2 pi) closed Int ``energy`` (R^2) dphi seen from each (x, y), smooth on ``scale`` about it.

    Each edge in pieces of v, place along it = b sinh v with b what keeps energy/R^2, R^2 = a^2 + place^2, smooth.
    """
    x0, x1, y0, y1 = window
    edges = [(x1 - x, y0 - y, y1 - y), (x - x0, y0 - y, y1 - y), (y1 - y, x0 - x, x1 - x), (y - y0, x0 - x, x1 - x)]
    node, gauss = np.polynomial.legendre.leggauss(8)
    total = np.zeros_like(x)
    for a, low, high in edges:
        b = np.hypot(a, scale)
        v0, v1 = np.arcsinh(low / b), np.arcsinh(high / b)
        pieces = max(1, math.ceil(float(np.max(v1 - v0)) / _EDGE_PIECE))
        half = 0.5 * (v1 - v0) / pieces
        for i in range(pieces):
            v = (v0 + (2 * i + 1) * half)[:, None] + half[:, None] * node
            place = b[:, None] * np.sinh(v)
            square = a[:, None] ** 2 + place**2
            seen = a[:, None] * b[:, None] * np.cosh(v) / square  # dphi/dv
            total += half * ((energy(square) * seen) @ gauss)
    return total / (2.0 * math.pi)
