"""Scatterings by chance: how many a surface gives a ray, and their spatial frequencies.

K-correlation spectra are drawn from as distributions. Nothing here is shared with the way images are computed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Scatterer:
    """One term of one surface's spectrum at one wavelength, as far as it scatters.

    ``mean`` number of scatterings [1], n ~ Poisson(mean); |f| = sqrt(exp(2 E/(C-1)) - 1)/B with E from the standard
    exponential distribution below ``longest``, which is U^(2/(1-C)) with U uniform; f ends at the horizon.
    """

    mean: float
    B: float
    C: float
    longest: float

    def frequencies(self, generator: np.random.Generator, count: int) -> Real:
        """``count`` draws of |f| [cycles/mm], exact."""
        E = generator.standard_exponential(count)
        beyond = self.longest < E
        if beyond.any():  # without memory: what is left beyond the end is distributed as from the start
            E[beyond] %= self.longest
        return self._frequency(E)

    def frequencies_at(self, uniform: Real) -> Real:
        """|f| [cycles/mm] at given values in [0, 1) of its cumulative distribution, shape of ``uniform``."""
        return self._frequency(-np.log1p(uniform * np.expm1(-self.longest)))

    def _frequency(self, E: Real) -> Real:
        E *= 2.0 / (self.C - 1.0)
        frequency: Real = np.sqrt(np.expm1(E, out=E), out=E)
        frequency /= self.B
        return frequency


def poisson_tail(mean: float) -> Real:
    """The probabilities of more than 0, 1, 2, ... scatterings of a ``mean`` number, decreasing to below 2^-53."""
    most = math.ceil(mean + 12.0 * math.sqrt(mean) + 40.0)
    n = np.arange(most + 1.0)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(n[1:]))])
    probability = np.exp(n * math.log(mean) - mean - log_factorial)
    beyond: Real = np.cumsum(probability[:0:-1])[::-1]
    return beyond[beyond > 2.0**-53]


def scatterers(surface: Surface, wavelength: float, cos_incidence: float | None = None) -> list[Scatterer]:
    """The terms of a ``surface`` that scatter at ``wavelength`` [mm]: those below the horizon n'/lambda.

    The mean is K^2 sigma_rel^2 with K = 2 pi (n' + n) cos_i/lambda for a mirror and 2 pi |n' - n| cos_i/lambda for a
    refracting surface; the incidence is the surface's unless ``cos_incidence`` is given.
    """
    index = surface.index_after
    step = index + surface.index_before if surface.is_mirror else index - surface.index_before
    cosine = math.cos(surface.incidence) if cos_incidence is None else cos_incidence
    phase = 2.0 * math.pi * step * cosine / wavelength
    found = [_below(term, index / wavelength, phase) for term in surface.psd]
    return [scatterer for scatterer in found if scatterer.mean > 0.0]


def _below(term: KCorrelation, horizon: float, phase: float) -> Scatterer:
    """The part of a ``term`` below the ``horizon`` [cycles/mm]; ``phase`` [rad] of 1 mm of height."""
    longest = 0.5 * (term.C - 1.0) * math.log1p((term.B * horizon) ** 2)
    return Scatterer((phase * term.sigma) ** 2 * -math.expm1(-longest), term.B, term.C, longest)


def repeatedly(tail: Sequence[float] | Real, uniform: Real) -> Iterator[Index]:
    """The rays that scatter once or more, twice or more, ...: those whose ``uniform`` number lies in the ``tail``.

    One number in [0, 1) per ray makes n ~ Poisson, by inversion.
    """
    ray = np.flatnonzero(uniform < tail[0])
    for probability in tail[1:]:
        yield ray
        ray = ray[uniform[ray] < probability]
        if ray.size == 0:
            return
    yield ray


def directions(generator: np.random.Generator, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit vectors (x, y) of even azimuth.

    Single precision turns or stretches a deviation by less than 1e-6 of itself, at random and without bias: boxes lose
    or gain 1e-6 of the light within 1e-6 of their edge, far less than rays that can be counted.
    """
    azimuth = generator.random(count, dtype=np.float32)
    azimuth *= np.float32(2.0 * math.pi)
    return np.cos(azimuth), np.sin(azimuth)
