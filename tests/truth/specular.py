"""The unscattered light in a rectangle, by rings of the pupil.

On a ring rho = const the ray errors are trigonometric polynomials of degree 2 in the azimuth. Their crossings with an
edge are the roots of a quartic in exp(i phi) (eigenvalues of its companion matrix), polished by Newton's method;
between neighbouring crossings the ray stays in or out. The lit fraction of the ring is then integrated over rho^2,
where rings may land in the rectangle at all, by panels halved where the fraction has kinks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .geometry import ray_error

if TYPE_CHECKING:
    from .system import TruthSystem

# Clenshaw-Curtis, exact to degree 12: its nodes include the ends, where a kink would hide from a Gauss rule
_NODES = np.cos(np.pi * np.arange(13) / 12.0)
_WEIGHTS = np.linalg.solve(np.polynomial.legendre.legvander(_NODES, 12).T, np.eye(13)[0] * 2.0)

_PANELS = 12  # to begin with, in each interval of rings
_MOST_CELLS = 4000


def _harmonics(system: TruthSystem, rho: np.ndarray) -> np.ndarray:
    """Fourier coefficients c_-2..c_2 of eps_x and eps_y on rings, shape [2, ring, 5]; an 8-point transform."""
    phi = 2.0 * np.pi * np.arange(8) / 8
    errors = np.array(ray_error(system, rho[:, None] * np.cos(phi), rho[:, None] * np.sin(phi)))
    return (np.fft.fft(errors, axis=-1) / 8)[..., [-2, -1, 0, 1, 2]]


def _value(c: np.ndarray, phi: np.ndarray, order: int = 0) -> np.ndarray:
    """Sum_k c_k (ik)^order exp(i k phi), real; c [..., 5], phi [..., m]."""
    k = np.arange(-2, 3)
    return np.einsum("...k,...mk->...m", c * (1j * k) ** order, np.exp(1j * phi[..., None] * k)).real


def _crossings(c: np.ndarray, edge: float) -> np.ndarray:
    """Azimuths [ring, 6] among which are all roots of Sum c_k exp(i k phi) = edge; the others do no harm."""
    c = c.copy()
    c[:, 2] -= edge
    scale = np.abs(c).max(axis=1, keepdims=True)
    c = c / np.where(scale > 0.0, scale, 1.0)
    lead = np.where(np.abs(c[:, 4]) > 1e-9, c[:, 4], 1.0)
    companion = np.zeros((len(c), 4, 4), complex)
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    companion[:, :, 3] = -c[:, :4] / lead[:, None]
    quartic = np.angle(np.linalg.eigvals(companion))
    amplitude = 2.0 * np.abs(c[:, 3])  # without the second harmonic: c_0 + amplitude cos(phi + arg c_1) = 0
    ratio = -c[:, 2].real / np.where(amplitude > 0.0, amplitude, 1.0)
    spread = np.arccos(np.clip(ratio, -1.0, 1.0))
    middle = -np.angle(c[:, 3])
    phi = np.concatenate([quartic, (middle + spread)[:, None], (middle - spread)[:, None]], axis=1)
    for _ in range(3):
        slope = _value(c, phi, 1)
        step = _value(c, phi) / np.where(np.abs(slope) > 1e-12, slope, np.inf)
        phi = phi - np.clip(step, -0.05, 0.05)
    return phi


def _inside(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """1 between low and high, 1/2 on either: light exactly on an edge is shared by its two pixels."""
    return np.heaviside(value - low, 0.5) - np.heaviside(value - high, 0.5)


def lit_fraction(system: TruthSystem, rho: np.ndarray, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Fraction of the lit part of each ring ``rho`` whose rays land in the rectangle [mm]."""
    cx, cy = _harmonics(system, rho)
    first, last = system.sector or (-np.pi, np.pi)
    cuts = np.concatenate([_crossings(cx, x0), _crossings(cx, x1), _crossings(cy, y0), _crossings(cy, y1)], axis=1)
    cuts = np.minimum(first + np.mod(cuts - first, 2.0 * np.pi), last)
    ends = np.ones((len(rho), 1))
    cuts = np.sort(np.concatenate([cuts, first * ends, last * ends], axis=1), axis=1)
    middle = 0.5 * (cuts[:, 1:] + cuts[:, :-1])
    ex, ey = ray_error(system, rho[:, None] * np.cos(middle), rho[:, None] * np.sin(middle))
    inside = _inside(ex, x0, x1) * _inside(ey, y0, y1)
    return (np.diff(cuts, axis=1) * inside).sum(axis=1) / (last - first)


def rings_that_may_land(system: TruthSystem, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Intervals of rho, shape [n, 2], outside which no ray lands in the rectangle [mm].

    Cells of the pupil are quartered, and those are kept whose rays, by the greatest slopes of the ray errors, may land
    there, until a cell's light is no wider than the rectangle (or ``_MOST_CELLS`` are kept). However small the
    rectangle, its rings are found.
    """
    first, last = system.sector or (-np.pi, np.pi)
    rho, phi = np.linspace(system.obscuration, 1.0, 33)[:, None], np.linspace(first, last, 193)
    fan = np.array(ray_error(system, rho * np.cos(phi), rho * np.sin(phi)))
    cells = np.array([[system.obscuration, 1.0, first, last]])
    slopes = [
        1.2 * np.abs(np.diff(fan, axis=axis)).max(axis=(1, 2)) / size
        for axis, size in ((1, (1.0 - system.obscuration) / 32.0), (2, (last - first) / 192.0))
    ]
    for _ in range(40):
        r0, r1, f0, f1 = cells.T
        r, f = 0.5 * (r0 + r1), 0.5 * (f0 + f1)
        ex, ey = ray_error(system, r * np.cos(f), r * np.sin(f))
        wide_x, wide_y = (0.5 * (r1 - r0) * slopes[0][i] + 0.5 * (f1 - f0) * slopes[1][i] for i in (0, 1))
        near = (ex + wide_x >= x0) & (ex - wide_x <= x1) & (ey + wide_y >= y0) & (ey - wide_y <= y1)
        cells, r, f = cells[near], r[near], f[near]
        small = 2.0 * wide_x.max() <= x1 - x0 and 2.0 * wide_y.max() <= y1 - y0
        if len(cells) == 0 or len(cells) > _MOST_CELLS or (small and r1[0] - r0[0] < 0.1):
            break
        r0, r1, f0, f1 = cells.T
        cells = np.concatenate(
            [np.stack(quarter, axis=1) for quarter in ((r0, r, f0, f), (r0, r, f, f1), (r, r1, f0, f), (r, r1, f, f1))]
        )
    return _joined(cells[:, :2])


def _joined(intervals: np.ndarray) -> np.ndarray:
    """The union of intervals [n, 2] as intervals that do not touch."""
    if len(intervals) == 0:
        return intervals
    low, high = intervals[np.argsort(intervals[:, 0])].T
    reach = np.maximum.accumulate(high)
    gap = np.append(True, low[1:] > reach[:-1] + 1e-15)
    return np.stack([low[gap], np.append(reach[:-1][gap[1:]], reach[-1])], axis=1)


def specular_energy(system: TruthSystem, x0: float, x1: float, y0: float, y1: float, tolerance: float = 1e-11) -> float:
    """Fraction of PSF_G in the rectangle [mm]; the light of the specular image is exp(-sum g) times this.

    Panels in rho^2, where rings may land, are halved until each differs from its halves by less than its share of
    ``tolerance``. Against the exact annulus and line: 1e-10 or better. A spot that collapses to a point on an edge
    counts half (a quarter at a corner).
    """
    inner = system.obscuration**2

    def integrate(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        half = 0.5 * (high - low)
        p = low[:, None] + half[:, None] * (1.0 + _NODES)
        return half * (lit_fraction(system, np.sqrt(p).ravel(), x0, x1, y0, y1).reshape(p.shape) @ _WEIGHTS)

    edges = [np.linspace(a * a, b * b, _PANELS + 1) for a, b in rings_that_may_land(system, x0, x1, y0, y1)]
    if not edges:
        return 0.0
    low, high = (np.concatenate([e[part] for e in edges]) for part in (slice(None, -1), slice(1, None)))
    share = tolerance * (1.0 - inner) / (2.0 * len(low))
    coarse = integrate(low, high)
    total = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        left, right = integrate(low, middle), integrate(middle, high)
        poor = np.abs(left + right - coarse) > share
        total += float((left + right)[~poor].sum())
        if not poor.any():
            break
        low, high = np.concatenate([low[poor], middle[poor]]), np.concatenate([middle[poor], high[poor]])
        coarse = np.concatenate([left[poor], right[poor]])
    else:
        total += float(coarse.sum())
    return total / (1.0 - inner)
