"""Energies of the composite image: PSF = exp(-sum g) PSF_G + PSF_G (x) S (Eq. 44), in any rectangle.

The scattered light of one ray in a rectangle is an integral over the angle at which it is seen,

    (1/2 pi) closed Int E(R) dphi = - (1/2 pi) closed Int [S beyond R] dphi   (the ray outside),

edge by edge with R = a cosh v, dphi = dv/cosh v (a: distance to the edge's line); small or distant rectangles are done
by a product Gauss rule of S itself. Then Gauss x trapezoid over the pupil, refined until it stands.
"""

from __future__ import annotations

import numpy as np

from .contour import ScatterTable, scatter_table, unclipped_height
from .geometry import pupil_rule, ray_error
from .horizon import missing_in_rectangle
from .specular import specular_energy
from .system import TruthSystem, specular_weight

Window = tuple[float, float, float, float]


def _edges(window: Window, x: np.ndarray, y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(distance to the line, positive on the inner side; from; to along it) of the four edges, seen from (x, y)."""
    x0, x1, y0, y1 = window
    return [
        (x1 - x, y0 - y, y1 - y), (x - x0, y0 - y, y1 - y),
        (y1 - y, x0 - x, x1 - x), (y - y0, x0 - x, x1 - x),
    ]  # fmt: skip


def _around(radial: object, window: Window, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(1/2 pi) closed Int f(R) dphi along the rectangle's edges, seen from each (x, y); f = ``radial``."""
    nodes, gauss = np.polynomial.legendre.leggauss(14)
    total = np.zeros_like(x)
    for a, low, high in _edges(window, x, y):
        some = a != 0.0
        distance = np.abs(a[some])
        v0, v1 = np.arcsinh(low[some] / distance), np.arcsinh(high[some] / distance)
        pieces = max(1, int(np.ceil(np.max(v1 - v0, initial=0.0) / 1.2)))
        half = 0.5 * (v1 - v0) / pieces
        part = np.zeros_like(distance)
        for i in range(pieces):
            v = (v0 + (2 * i + 1) * half)[:, None] + half[:, None] * nodes
            part += half * ((radial(distance[:, None] * np.cosh(v)) / np.cosh(v)) @ gauss)
        total[some] += np.sign(a[some]) * part
    return total / (2.0 * np.pi)


def _scattered(table: ScatterTable, window: Window, x: np.ndarray, y: np.ndarray, core: float) -> np.ndarray:
    """Unclipped scattered energy in the window, of light centred on each (x, y)."""
    x0, x1, y0, y1 = window
    gap = np.hypot(np.maximum(0.0, np.maximum(x0 - x, x - x1)), np.maximum(0.0, np.maximum(y0 - y, y - y1)))
    result = np.empty_like(x)
    small = max(x1 - x0, y1 - y0) < 0.5 * np.hypot(gap, core)
    if small.any():
        nodes, gauss = np.polynomial.legendre.leggauss(8)
        dx = 0.5 * (x1 + x0 + (x1 - x0) * nodes)[None, :, None] - x[small]
        dy = 0.5 * (y1 + y0 + (y1 - y0) * nodes)[:, None, None] - y[small]
        result[small] = np.einsum("i,j,ijk->k", gauss, gauss, table.psf(np.hypot(dx, dy))) * (x1 - x0) * (y1 - y0) / 4.0
    away = ~small & (gap > 0.0)
    result[away] = -_around(table.outside, window, x[away], y[away])
    within = ~small & (gap == 0.0)
    result[within] = _around(table.inside, window, x[within], y[within])
    return result


def scattered_energy(system: TruthSystem, window: Window, tolerance: float = 1e-11) -> float:
    """Energy of PSF_G (x) S in the window; pupil nodes are doubled until it changes by less than 1e-10 of itself.

    Raises ArithmeticError if 256 x 768 nodes do not suffice (knee far narrower than the spot).
    """
    if not system.surfaces:
        return 0.0
    table = scatter_table(system.wavelength, system.surfaces)
    core = min(system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms)
    before = None
    for doubling in range(5):
        x, y, w = pupil_rule(system, 16 << doubling, 48 << doubling)
        ex, ey = ray_error(system, x, y)
        point = np.ptp(ex) == 0.0 and np.ptp(ey) == 0.0
        if point:
            ex, ey, w = ex[:1], ey[:1], np.ones(1)
        value = float(w @ _scattered(table, window, ex, ey, core))
        if point or (before is not None and abs(value - before) < max(1e-10 * abs(value), tolerance)):
            break
        before = value
    else:
        raise ArithmeticError(f"pupil rule not converged: {before} against {value}")
    x, y, w = pupil_rule(system, 4, 12)
    return value - missing_in_rectangle(system, window, *ray_error(system, x, y), w)


def pixel_energy(system: TruthSystem, x0: float, x1: float, y0: float, y1: float) -> float:
    """Fraction of all light in the rectangle x0..x1, y0..y1 [mm] about the Gaussian image point.

    Scattered light to 1e-9 relative (at 30 d and nearer), unscattered light to 1e-10 absolute.
    """
    specular = specular_weight(system)
    unscattered = specular * specular_energy(system, x0, x1, y0, y1) if specular > 1e-18 else 0.0
    return unscattered + scattered_energy(system, (x0, x1, y0, y1))


def box_energy(system: TruthSystem, half_width: float, centre: tuple[float, float] = (0.0, 0.0)) -> float:
    """Ensquared energy: the square of ``half_width`` [mm] about ``centre`` [mm]; absolute error below 1e-9."""
    cx, cy = centre
    return pixel_energy(system, cx - half_width, cx + half_width, cy - half_width, cy + half_width)


def outside_fraction(system: TruthSystem, x0: float, x1: float, y0: float, y1: float) -> float:
    """Fraction of all light outside the window, absolute error below 1e-9: what lies beyond its edges, added up.

    The scattered part is (1/2 pi) closed Int [S beyond R] dphi over the edges as each ray sees them, plus the whole of
    S for rays that land outside; the tail beyond the table is what the known total 1 - exp(-sum g) leaves. It shares
    the table with ``box_energy``: for that same window the two add to 1 by construction, not so for sums over pixels.
    """
    specular = specular_weight(system)
    beyond = 1.0 - specular_energy(system, x0, x1, y0, y1)
    if not system.surfaces:
        return beyond
    table = scatter_table(system.wavelength, system.surfaces)
    total = float(unclipped_height(system.wavelength, system.surfaces)) - specular
    window = (x0, x1, y0, y1)

    def scattered(rings: int, spokes: int) -> float:
        x, y, w = pupil_rule(system, rings, spokes)
        ex, ey = ray_error(system, x, y)
        inside = (ex > x0) & (ex < x1) & (ey > y0) & (ey < y1)
        return float(w @ (_around(table.outside, window, ex, ey) + np.where(inside, 0.0, table.total)))

    value = scattered(32, 96)
    x, y, w = pupil_rule(system, 4, 12)
    clip = missing_in_rectangle(system, window, *ray_error(system, x, y), w)
    # S = unclipped - D: outside = [outside of the unclipped] - [total of D] + [D inside]
    return specular * beyond + value + (total - table.total) - (total - (1.0 - specular)) + clip
