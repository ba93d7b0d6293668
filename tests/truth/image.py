"""The composite image of one field in many rectangles: the quick judge, for images whose halo is tabled once.

As ``ensquared``, an energy is the unscattered light of the rectangle plus that of S about every ray. The scattered
light of a ray at (x, y) in a rectangle, by where the ray is (c: narrowest knee, gap: distance to the rectangle):

- rectangle small against hypot(gap, c): a product Gauss rule of S, to relative accuracy;
- ray outside: - (1/2 pi) closed Int [energy beyond R] dphi along the edges, to relative accuracy;
- ray inside, or no farther outside than c/2: four corners I(X, Y), the energy in 0..X x 0..Y, from a table.

The pupil is integrated by cells of rho^2 x azimuth with product Gauss rules, quartered until they stand.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import RectBivariateSpline

from .geometry import ray_error
from .radial import RadialScatter, radial_scatter
from .specular import specular_energy
from .system import TruthSystem, specular_weight

Window = tuple[float, float, float, float]
Density = Callable[[np.ndarray, np.ndarray], np.ndarray]

RELATIVE, FAINTEST = 1e-9, 1e-35  # of each rectangle's scattered light: a core missed by all rays shows in its tail
_UNSCATTERED = 3e-10  # the tolerance of unscattered light, of all light
_MOST_CELLS = 100_000
_CORNER_STEP = 0.05  # of asinh(X/c), for a quintic spline: 1e-10 of the light
_EDGE_PIECE = 1.0
_RAYS_AT_ONCE = 20_000


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
            self._corners = _corner_table(self.halo, self._core, reach)
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

    def scattered(self, window: Window) -> float:
        """Energy of PSF_G (x) S in the window."""
        if self.halo is None:
            return 0.0
        if self.is_point:
            x, y = (np.array([self.bounds[i]]) for i in (0, 2))
            return float(self._about(window, x, y)[0])
        return pupil_mean(self.system, lambda x, y: self._about(window, x, y))

    def energy(self, window: Window) -> float:
        """Fraction of all light in the window (x0, x1, y0, y1) [mm]."""
        lit = self.specular * self.unscattered(window) if self.specular > 1e-18 else 0.0
        return lit + self.scattered(window)

    def square(self, half_width: float, centre: tuple[float, float] = (0.0, 0.0)) -> float:
        """Ensquared energy: the square of ``half_width`` [mm] about ``centre`` [mm]."""
        cx, cy = centre
        return self.energy((cx - half_width, cx + half_width, cy - half_width, cy + half_width))

    def _about(self, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The energy of S about each ray in the window."""
        assert self.halo is not None
        x0, x1, y0, y1 = window
        gap = np.hypot(np.maximum(0.0, np.maximum(x0 - x, x - x1)), np.maximum(0.0, np.maximum(y0 - y, y - y1)))
        small = max(x1 - x0, y1 - y0) < 0.5 * np.hypot(gap, self._core)
        away = ~small & (gap > 0.5 * self._core)
        near = ~small & ~away
        result = np.empty_like(x)
        if small.any():
            result[small] = _product_rule(self.halo, window, x[small], y[small])
        if away.any():
            result[away] = _from_outside(self.halo, window, x[away], y[away], gap[away])
        if near.any():
            result[near] = self._by_corners(window, x[near], y[near])
        return result

    def _by_corners(self, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        a, b, c, d = (np.arcsinh(v / self._core) for v in (window[0] - x, window[1] - x, window[2] - y, window[3] - y))
        corner = self._corners
        return corner(b, d) - corner(a, d) - corner(b, c) + corner(a, c)


def _azimuths(system: TruthSystem) -> tuple[float, float]:
    return system.sector or (0.0, 2.0 * math.pi)


def pupil_mean(system: TruthSystem, density: Density) -> float:
    """The mean over the lit pupil of ``density`` (eps_x, eps_y) [any unit], smooth in the image plane.

    Cells are quartered until a cell and its quarters agree within 1/32 of ``RELATIVE`` of the whole.
    The rule, of degree 13, then errs by far less. Raises ArithmeticError beyond ``_MOST_CELLS``.
    """
    inner, (first, last) = system.obscuration**2, _azimuths(system)
    node, gauss = np.polynomial.legendre.leggauss(7)
    area = (1.0 - inner) * (last - first)

    def rule(cells: np.ndarray) -> np.ndarray:  # cells [n, 4] of (p0, p1, phi0, phi1); their shares of the mean
        values = np.empty(len(cells))
        for i in range(0, len(cells), _RAYS_AT_ONCE // 49):
            p0, p1, f0, f1 = cells[i : i + _RAYS_AT_ONCE // 49].T
            rho = np.sqrt(0.5 * (p1 + p0)[:, None, None] + 0.5 * (p1 - p0)[:, None, None] * node[:, None])
            phi = 0.5 * (f1 + f0)[:, None, None] + 0.5 * (f1 - f0)[:, None, None] * node
            ex, ey = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
            found = density(ex.ravel(), ey.ravel()).reshape(ex.shape)
            values[i : i + _RAYS_AT_ONCE // 49] = (
                0.25 * (p1 - p0) * (f1 - f0) / area * np.einsum("i,j,nij->n", gauss, gauss, found)
            )
        return values

    spokes = max(1, round(8.0 * (last - first) / (2.0 * math.pi)))
    p, f = np.linspace(inner, 1.0, 3), np.linspace(first, last, spokes + 1)
    cells = np.array([(p[i], p[i + 1], f[j], f[j + 1]) for i in range(2) for j in range(spokes)])
    coarse, settled = rule(cells), 0.0
    while len(cells):
        if len(cells) > _MOST_CELLS:
            raise ArithmeticError(f"{len(cells)} cells of the pupil do not suffice")
        quarters = _quartered(cells)
        fine = rule(quarters)
        together = fine.reshape(-1, 4).sum(axis=1)
        whole = settled + together.sum()
        poor = np.abs(together - coarse) > max(RELATIVE * abs(whole), FAINTEST) / 32.0
        settled += together[~poor].sum()
        poor4 = np.repeat(poor, 4)
        cells, coarse = quarters[poor4], fine[poor4]
    return float(settled)


def _quartered(cells: np.ndarray) -> np.ndarray:
    """The four quarters of each cell, one cell's after another's."""
    p0, p1, f0, f1 = cells.T
    p, f = 0.5 * (p0 + p1), 0.5 * (f0 + f1)
    quarters = [(p0, p, f0, f), (p0, p, f, f1), (p, p1, f0, f), (p, p1, f, f1)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 4)


def _product_rule(halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x0, x1, y0, y1 = window
    node, gauss = np.polynomial.legendre.leggauss(6)
    dx = 0.5 * (x1 + x0 + (x1 - x0) * node)[None, :, None] - x
    dy = 0.5 * (y1 + y0 + (y1 - y0) * node)[:, None, None] - y
    return np.einsum("i,j,ijk->k", gauss, gauss, halo.psf(dx * dx + dy * dy)) * (x1 - x0) * (y1 - y0) / 4.0


def _from_outside(halo: RadialScatter, window: Window, x: np.ndarray, y: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Each edge in pieces of v, place along it = b sinh v with b what keeps R^2 = a^2 + place^2 smooth.

    The energy beyond the farthest corner is common to all edges, and closed Int dphi = 0: it is left out.
    """
    x0, x1, y0, y1 = window
    edges = [(x1 - x, y0 - y, y1 - y), (x - x0, y0 - y, y1 - y), (y1 - y, x0 - x, x1 - x), (y - y0, x0 - x, x1 - x)]
    node, gauss = np.polynomial.legendre.leggauss(8)
    farthest = halo.outside(np.hypot(np.maximum(x1 - x, x - x0), np.maximum(y1 - y, y - y0)))
    total = np.zeros_like(x)
    for a, low, high in edges:
        b = np.hypot(a, gap)
        v0, v1 = np.arcsinh(low / b), np.arcsinh(high / b)
        pieces = max(1, math.ceil(float(np.max(v1 - v0)) / _EDGE_PIECE))
        half = 0.5 * (v1 - v0) / pieces
        for i in range(pieces):
            v = (v0 + (2 * i + 1) * half)[:, None] + half[:, None] * node
            place = b[:, None] * np.sinh(v)
            square = a[:, None] ** 2 + place**2
            seen = a[:, None] * b[:, None] * np.cosh(v) / square  # dphi/dv
            total -= half * (((halo.outside(square) - farthest[:, None]) * seen) @ gauss)
    return total / (2.0 * math.pi)


def _corner_table(halo: RadialScatter, core: float, reach: float) -> Density:
    """I(X, Y), odd in both, at asinh(X/core) and asinh(Y/core): Int_0^Y E(R) X/(2 pi R^2) dy, and the same of Y, X.

    The integrals along y grow step by step along the table's own grid.
    """
    grid = _CORNER_STEP * np.arange(math.ceil(math.asinh(reach / core) / _CORNER_STEP) + 6)
    node, gauss = np.polynomial.legendre.leggauss(5)
    t = grid[:-1, None] + 0.5 * _CORNER_STEP * (1.0 + node)
    X, y = core * np.sinh(grid)[:, None], (core * np.sinh(t)).ravel()
    dy = (0.5 * _CORNER_STEP * gauss * core * np.cosh(t)).ravel()
    square = X * X + y * y
    steps = halo.inside(square) * X / square * dy / (2.0 * math.pi)
    steps = steps.reshape(len(grid), len(grid) - 1, 5).sum(axis=2)
    one = np.concatenate([np.zeros((len(grid), 1)), np.cumsum(steps, axis=1)], axis=1)
    corner = one + one.T
    mirror = 6  # so that the spline knows that I is odd
    both = np.concatenate([-grid[mirror:0:-1], grid])
    full = np.empty((len(both), len(both)))
    full[mirror:, mirror:] = corner
    full[:mirror, mirror:] = -corner[mirror:0:-1]
    full[:, :mirror] = -full[:, 2 * mirror : mirror : -1]
    spline = RectBivariateSpline(both, both, full, kx=5, ky=5)
    limit = float(grid[-1])

    def at(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        size_s, size_t = np.minimum(np.abs(s), limit), np.minimum(np.abs(t), limit)
        return np.sign(s) * np.sign(t) * spline.ev(size_s, size_t)

    return at
