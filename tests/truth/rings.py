"""What of a ring of the pupil lands in a rectangle: crossings with its edges as roots of quartics.

On a ring rho = const the ray errors are trigonometric polynomials of degree 2 in the azimuth. Their crossings with an
edge are the real roots of a quartic in tan(psi/2) (eigenvalues of its companion matrix), psi counted from opposite to
where the ray is farthest from the edge, so that the leading coefficient is the largest value; Newton's method polishes
them. Between neighbouring crossings the ray stays in or out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .geometry import ray_error

if TYPE_CHECKING:
    from .system import TruthSystem

_SAMPLES = 2.0 * np.pi * np.arange(8) / 8
_SAME = 1e-10  # [rad] crossings this near each other are one

_Edge: TypeAlias = float | np.ndarray


def harmonics(system: TruthSystem, rho: np.ndarray) -> np.ndarray:
    """Fourier coefficients c_0..c_2 of eps_x and eps_y on rings, shape [2, ring, 3]; an 8-point transform."""
    errors = np.array(ray_error(system, rho[:, None] * np.cos(_SAMPLES), rho[:, None] * np.sin(_SAMPLES)))
    return (np.fft.fft(errors, axis=-1) / 8)[..., :3]


def _crossings(c: np.ndarray) -> np.ndarray:
    """Azimuths [..., 4] among which are all roots of f = c_0 + 2 Re(c_1 exp(i phi) + c_2 exp(2 i phi)), c [..., 3]."""
    turns = np.exp(1j * _SAMPLES)
    sampled = c[..., :1].real + 2.0 * (c[..., 1:2] * turns + c[..., 2:] * turns**2).real
    start = _SAMPLES[np.argmax(np.abs(sampled), axis=-1)] - np.pi
    d0, d1, d2 = c[..., 0].real, 2.0 * c[..., 1] * np.exp(1j * start), 2.0 * c[..., 2] * np.exp(2j * start)
    # (1 + t^2)^2 f at psi = phi - start, t = tan(psi/2): exp(i psi) = (1 + i t)/(1 - i t)
    lead = d0 - d1.real + d2.real
    lead = np.where(lead == 0.0, 1.0, lead)
    companion = np.zeros((*lead.shape, 4, 4))
    companion[..., [1, 2, 3], [0, 1, 2]] = 1.0
    companion[..., 0, 3] = -(d0 + d1.real + d2.real) / lead
    companion[..., 1, 3] = (2.0 * d1.imag + 4.0 * d2.imag) / lead
    companion[..., 2, 3] = -(2.0 * d0 - 6.0 * d2.real) / lead
    companion[..., 3, 3] = (2.0 * d1.imag - 4.0 * d2.imag) / lead
    phi = start[..., None] + 2.0 * np.arctan(np.linalg.eigvals(companion).real)
    for _ in range(3):
        turn = np.exp(1j * phi)
        first, second = c[..., 1:2] * turn, c[..., 2:] * turn**2
        value, slope = c[..., :1].real + 2.0 * (first + second).real, -2.0 * (first + 2.0 * second).imag
        step = value / np.where(np.abs(slope) > 1e-12 * np.abs(first + second), slope, np.inf)
        phi = phi - np.clip(step, -0.05, 0.05)
    return phi


def _inside(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """1 between low and high, 1/2 on either: light exactly on an edge is shared by its two pixels."""
    return np.heaviside(value - low, 0.5) - np.heaviside(value - high, 0.5)


def landing(
    system: TruthSystem, rho: np.ndarray, x0: _Edge, x1: _Edge, y0: _Edge, y1: _Edge
) -> tuple[np.ndarray, np.ndarray]:
    """Fraction of the lit part of each ring ``rho`` whose rays land in the rectangle [mm], and through which edges.

    The latter, how many times the ring passes each of the four edges, shape [ring, 4], changes where the fraction has a
    kink: where a ring touches an edge, passes a corner, or where the end of its lit part does. An edge may be an array,
    each ring's own.
    """
    c = np.repeat(harmonics(system, rho), 2, axis=0)  # [edge, ring, 3]
    x0, x1, y0, y1 = edges = [np.reshape(edge, (-1, 1)) for edge in (x0, x1, y0, y1)]  # [ring, 1]
    c[..., 0] -= np.concatenate(np.broadcast_arrays(*edges), axis=1).T
    first, last = system.sector or (-np.pi, np.pi)
    cuts = np.full((len(rho), 18), first)
    cuts[:, 17] = last
    edge, ring = np.nonzero(np.abs(c[..., 0].real) <= 2.1 * (np.abs(c[..., 1]) + np.abs(c[..., 2])))
    if len(ring):
        phi = _crossings(c[edge, ring])
        cuts[ring[:, None], 1 + 4 * edge[:, None] + np.arange(4)] = np.minimum(
            first + np.mod(phi - first, 2.0 * np.pi), last
        )
    order = np.argsort(cuts, axis=1)
    cuts = np.take_along_axis(cuts, order, 1)
    middle, length = 0.5 * (cuts[:, 1:] + cuts[:, :-1]), np.diff(cuts, axis=1)
    ex, ey = ray_error(system, rho[:, None] * np.cos(middle), rho[:, None] * np.sin(middle))
    inside = _inside(ex, x0, x1) * _inside(ey, y0, y1)
    before = np.maximum.accumulate(np.where(length > _SAME, np.arange(17), 0), axis=1)
    state = np.take_along_axis(inside, before, 1)
    passed = (state[:, 1:] != state[:, :-1])[..., None] & ((order[:, 1:-1, None] - 1) // 4 == np.arange(4))
    return (length * inside).sum(axis=1) / (last - first), passed.sum(axis=1)
