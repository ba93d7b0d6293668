"""Scatter at real angles: the two-parameter generalised Harvey-Shack family, drawn from exactly.

Krywonos, Harvey & Choi (JOSA A 28, 1121, 2011): the light scattered to theta_s is sum_n Poisson(n; g(theta_i, theta_s))
p_n, with p_n the n-fold spectrum at (beta_s - beta_0) n'/lambda, renormalised over the propagating hemisphere to
TIS = 1 - exp(-g(theta_i, theta_0)), theta_0 that of the specular ray; the rest is specular.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from psfcli.montecarlo.spectrum import Scatterer, directions, poisson_tail, repeatedly

Real = NDArray[np.float64]
RelativeMean = Callable[[NDArray[np.intp], Real], Real]


def scattered(
    terms: Sequence[Scatterer],
    generator: np.random.Generator,
    uniform: Real,
    specular: tuple[Real, Real],
    scale: float,
    relative_mean: RelativeMean,
) -> tuple[Real, Real]:
    """Direction cosines (x, y) in the tangent plane behind one surface, from those of the ``specular`` ray.

    ``terms`` have the means of normal incidence, whose sum is g; ``relative_mean`` gives g(theta_i, theta_s)/g of some
    rays (by index) with the cosines of their theta_s, at most 1. ``uniform`` in [0, 1) decides whether, and first of
    all how often, a ray scatters; ``scale`` is lambda/n' [mm].

    Proposals n ~ Poisson(g), n > 0, are accepted with q^n exp(g (1 - q)), q the relative mean, over the largest value
    of that, max(1, exp(g - 1)/g). What would leave the hemisphere, or is not accepted, is drawn again: this is the
    renormalisation, and nothing is lost.
    """
    x, y = specular[0].copy(), specular[1].copy()
    g = sum(term.mean for term in terms)
    if g == 0.0:
        return x, y
    tail = poisson_tail(g)
    rough = -np.expm1(-g * relative_mean(np.arange(x.size), np.sqrt(1.0 - x**2 - y**2)))
    waiting = np.flatnonzero(uniform < rough)
    number = uniform[waiting] / rough[waiting] * tail[0]
    most = math.exp(g - 1.0) / g if g > 1.0 else 1.0
    while waiting.size:
        n, fx, fy = _deviations(terms, tail, generator, number)
        beta_x, beta_y = specular[0][waiting] + scale * fx, specular[1][waiting] + scale * fy
        cosine = np.sqrt(np.maximum(1.0 - beta_x**2 - beta_y**2, 0.0))
        q = relative_mean(waiting, cosine)
        accepted = (cosine > 0.0) & (most * generator.random(n.size) < q**n * np.exp(g * (1.0 - q)))
        done = waiting[accepted]
        x[done], y[done] = beta_x[accepted], beta_y[accepted]
        waiting = waiting[~accepted]
        number = tail[0] * generator.random(waiting.size)
    return x, y


def _deviations(
    terms: Sequence[Scatterer], tail: Real, generator: np.random.Generator, number: Real
) -> tuple[NDArray[np.intp], Real, Real]:
    """How often rays are scattered, and the sums of their spatial frequencies in x and y [cycles/mm]."""
    bounds = np.cumsum([term.mean for term in terms])
    n = np.zeros(number.size, dtype=np.intp)
    fx, fy = np.zeros(number.size), np.zeros(number.size)
    for ray in repeatedly(tail, number):
        n[ray] += 1
        which = np.searchsorted(bounds[:-1], bounds[-1] * generator.random(ray.size), side="right")
        f = np.empty(ray.size)
        for i, term in enumerate(terms):
            own = np.flatnonzero(which == i)
            f[own] = term.frequencies(generator, own.size)
        along_x, along_y = directions(generator, ray.size)
        fx[ray] += f * along_x
        fy[ray] += f * along_y
    return n, fx, fy
