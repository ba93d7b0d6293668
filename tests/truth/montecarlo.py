"""The image by sampling: every ray its own pupil point, ray error and deviations. True within its standard error.

At each surface a ray is deviated n ~ Poisson(g) times by lambda d f, where f is drawn from the two-dimensional spectrum
below 1/lambda: a term chosen by its variance there, |f| = sqrt(U^(2/(1-C)) - 1)/B, any azimuth. Spectra are cut at
1/lambda here, while the transfer function is clipped: the two differ only in light near 90 degrees.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .geometry import ray_error
from .system import phase_variance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .system import RoughSurface, TruthSystem

CHUNK = 1 << 19


def _spatial_frequencies(rng: np.random.Generator, wavelength: float, surface: RoughSurface, count: int) -> np.ndarray:
    """``count`` draws of |f| < 1/lambda [cycles/mm] from the sum of the surface's terms."""
    floors = surface.beyond(wavelength)
    share = np.array([t.sigma**2 * (1.0 - floor) for t, floor in zip(surface.terms, floors, strict=True)])
    which = rng.choice(len(share), size=count, p=share / share.sum())
    f = np.empty(count)
    for i, (t, floor) in enumerate(zip(surface.terms, floors, strict=True)):
        own = which == i
        u = 1.0 - (1.0 - floor) * rng.random(np.count_nonzero(own))
        f[own] = np.sqrt(np.expm1(2.0 / (1.0 - t.C) * np.log(u))) / t.B
    return f


def landings(system: TruthSystem, rays: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Landing points (x, y) [mm] about the Gaussian image point, in chunks."""
    rng = np.random.default_rng(seed)
    inner = system.obscuration**2
    first, last = system.sector or (0.0, 2.0 * math.pi)
    for start in range(0, rays, CHUNK):
        m = min(CHUNK, rays - start)
        rho, phi = np.sqrt(inner + (1.0 - inner) * rng.random(m)), first + (last - first) * rng.random(m)
        x, y = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
        for surface in system.surfaces:
            n = rng.poisson(phase_variance(system.wavelength, surface), m)
            ray = np.repeat(np.arange(m), n)
            r = system.wavelength * surface.d * _spatial_frequencies(rng, system.wavelength, surface, ray.size)
            azimuth = 2.0 * math.pi * rng.random(ray.size)
            x = x + np.bincount(ray, r * np.cos(azimuth), m)
            y = y + np.bincount(ray, r * np.sin(azimuth), m)
        yield x, y


def sampled_pixels(
    system: TruthSystem, edges_x: np.ndarray, edges_y: np.ndarray, rays: int, seed: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Energy per pixel [y, x] between the (ascending) edges [mm], and its standard error."""
    nx, ny = len(edges_x) - 1, len(edges_y) - 1
    counts = np.zeros(nx * ny, np.int64)
    for x, y in landings(system, rays, seed):
        i, j = np.searchsorted(edges_x, x, "right") - 1, np.searchsorted(edges_y, y, "right") - 1
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
        counts += np.bincount(j[inside] * nx + i[inside], minlength=nx * ny)
    p = counts.reshape(ny, nx) / rays
    return p, np.sqrt(np.maximum(p * (1.0 - p), 1.0 / rays**2) / rays)


def sampled_boxes(
    system: TruthSystem, half_widths: np.ndarray, rays: int, seed: int = 1, centre: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Ensquared energy in squares of (ascending) ``half_widths`` [mm] about ``centre`` [mm], and its standard error."""
    counts = np.zeros(len(half_widths) + 1, np.int64)
    for x, y in landings(system, rays, seed):
        reach = np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1]))
        counts += np.bincount(np.searchsorted(half_widths, reach), minlength=counts.size)
    p = np.cumsum(counts[:-1]) / rays
    return p, np.sqrt(np.maximum(p * (1.0 - p), 1.0 / rays**2) / rays)
