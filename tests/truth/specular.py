"""The unscattered light in a rectangle, by rings of the pupil.

On a ring rho = const the ray errors are trigonometric polynomials of degree 2 in the azimuth. Their crossings with an
edge are the roots of a quartic in exp(i phi) (eigenvalues of its companion matrix), polished by Newton's method;
between neighbouring crossings the ray stays in or out. The lit fraction of the ring is then integrated over rho^2 by
panels halved where the fraction has kinks.
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


def specular_energy(
    system: TruthSystem, x0: float, x1: float, y0: float, y1: float, tolerance: float = 1e-11, panels: int = 32
) -> float:
    """Fraction of PSF_G in the rectangle [mm]; the light of the specular image is exp(-sum g) times this.

    ``panels`` in rho^2 are halved until each differs from its halves by less than its share of ``tolerance``. Against
    the exact annulus and line: 1e-10 or better. A spot that collapses to a point on an edge counts half (a quarter at
    a corner).
    """
    inner = system.obscuration**2

    def integrate(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        half = 0.5 * (high - low)
        p = low[:, None] + half[:, None] * (1.0 + _NODES)
        return half * (lit_fraction(system, np.sqrt(p).ravel(), x0, x1, y0, y1).reshape(p.shape) @ _WEIGHTS)

    edges = np.linspace(inner, 1.0, panels + 1)
    low, high = edges[:-1], edges[1:]
    coarse = integrate(low, high)
    total = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        left, right = integrate(low, middle), integrate(middle, high)
        poor = np.abs(left + right - coarse) > tolerance * (1.0 - inner) / (2.0 * panels)
        total += float((left + right)[~poor].sum())
        if not poor.any():
            break
        low, high = np.concatenate([low[poor], middle[poor]]), np.concatenate([middle[poor], high[poor]])
        coarse = np.concatenate([left[poor], right[poor]])
    else:
        total += float(coarse.sum())
    return total / (1.0 - inner)
