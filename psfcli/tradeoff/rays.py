"""Rays followed one by one: the geometrical image by counting, and its scatter by chance (Appendix A) [mm]."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from psfcli.image.geometric import along_fans, azimuth_rule, ray_fans
from psfcli.image.grid import Detector
from psfcli.montecarlo.spectrum import scatterers
from psfcli.planning.plan import Plan
from psfcli.surface.harvey_shack import phase_variance

Real = NDArray[np.float64]

_AT_ONCE = 1 << 19  # rays and scatterings: what a chunk of them holds


def pupil_grid(scene: Plan, count: int) -> Iterator[tuple[Real, Real]]:
    """Landing points (x, y) [mm] of a regular grid of about ``count`` rays that do not scatter, in chunks.

    As many pupil radii, at equal steps of rho^2, as azimuths: every ray stands for the same area of the pupil.
    """
    telescope, field = scene.telescope, scene.fields[0]
    edge = math.isqrt(count)
    inner = telescope.pupil.obscuration**2
    rho = np.sqrt(inner + (1.0 - inner) * (np.arange(edge) + 0.5) / edge)
    azimuth = azimuth_rule(telescope, field, edge)
    for part in np.array_split(azimuth, math.ceil(count / _AT_ONCE)):
        fans_x, fans_y = ray_fans(telescope, field, part)
        yield along_fans(fans_x, rho).ravel(), along_fans(fans_y, rho).ravel()


def scattered_rays(scene: Plan, count: int, seed: int = 0) -> Iterator[tuple[Real, Real]]:
    """Landing points (x, y) [mm] of ``count`` Monte Carlo rays, in chunks; the same for the same ``seed``.

    Each ray has its own pupil point. Every PSD term of every surface deviates it n times by lambda d_j f, n drawn from
    the Poisson distribution of mean K^2 sigma_rel^2 and f from the two-dimensional spectrum below the horizon.
    """
    generator = np.random.default_rng(seed)
    telescope, wavelength = scene.telescope, scene.wavelengths[0]
    inner = telescope.pupil.obscuration**2
    start, stop = telescope.pupil.sector
    scatterings = sum(phase_variance(surface, wavelength) for surface in scene.surfaces)
    at_once = math.ceil(_AT_ONCE / (1.0 + scatterings))
    for first in range(0, count, at_once):
        size = min(at_once, count - first)
        rho = np.sqrt(inner + (1.0 - inner) * generator.random(size))
        fans = ray_fans(telescope, scene.fields[0], start + (stop - start) * generator.random(size))
        x, y = (np.asarray(polyval(rho, fan, tensor=False), dtype=np.float64) for fan in fans)
        for surface in scene.surfaces:
            scale = wavelength * telescope.magnified_distance(surface.marginal_height)
            for term in scatterers(surface, wavelength):
                ray = np.repeat(np.arange(size), generator.poisson(term.mean, size))
                deviation = scale * term.frequencies(generator, ray.size)
                azimuth = 2.0 * math.pi * generator.random(ray.size)
                x += np.bincount(ray, deviation * np.cos(azimuth), size)
                y += np.bincount(ray, deviation * np.sin(azimuth), size)
        yield x, y


def counted(landings: Iterable[tuple[Real, Real]], detector: Detector, half_width: Real) -> tuple[Real, Real]:
    """The share of the rays in each pixel of the ``detector`` [y, x], and in each box of increasing ``half_width``.

    Boxes [mm] are squares about the Gaussian image point.
    """
    n = detector.pixels
    pixels = np.zeros(n * n)
    boxes = np.zeros(half_width.size + 1)
    rays = 0
    for x, y in landings:
        column = np.floor((x - detector.start(0)) / detector.pixel).astype(np.intp)
        row = np.floor((y - detector.start(1)) / detector.pixel).astype(np.intp)
        hit = (column >= 0) & (column < n) & (row >= 0) & (row < n)
        pixels += np.bincount(row[hit] * n + column[hit], minlength=pixels.size)
        reach = np.maximum(np.abs(x), np.abs(y))
        boxes += np.bincount(np.searchsorted(half_width, reach), minlength=boxes.size)
        rays += x.size
    return pixels.reshape(n, n) / rays, np.cumsum(boxes[:-1]) / rays
