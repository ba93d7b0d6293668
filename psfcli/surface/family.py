"""The family of transforms that one surface has at different phases per height: each scatter angle asks for its own.

With x = K^2,  F(f; x) = Int [exp(-x sigma_rel^2 + x C(r)) - exp(-x sigma_rel^2)] exp(-2 pi i f.r) d^2r,  and F/x is a
positive entire function of x that tends to the spectrum S2(f) at x = 0. Its logarithm is interpolated at Chebyshev
nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from psfcli.surface.bsdf import resolved, scatter_terms, variances
from psfcli.surface.harvey_shack import relative_rms
from psfcli.surface.mixture import MixtureError
from psfcli.surface.surface import Surface

Real = NDArray[np.float64]

_ERROR = 1e-10  # of the interpolation
_NODES = (12, 24, 48, 96)
_SMALLEST = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True)
class TransformFamily:
    """F(f; K^2) of one surface at one wavelength for K between two limits, built by ``transform_family``.

    ``mean`` and ``half`` [rad^2/mm^2] are the middle and half the width of the range of K^2; ``weight`` [variance,
    node] and ``variance`` [1/mm^2] are the mixtures at the nodes; ``sigma_rel`` [mm] is that of normal incidence.
    """

    mean: float
    half: float
    weight: Real
    variance: Real
    sigma_rel: float

    def transform(self, frequency: Real, K: Real, sigma_rel: float) -> Real:
        """F [mm^2] at ``frequency`` [cycles/mm] and phase per height ``K`` [rad/mm], of one shape, which comes back.

        ``sigma_rel`` [mm] is the rms that scatters. Relative error 1e-8; 0 below the normal doubles.
        """
        coefficients = self._coefficients(frequency)
        x = K * K
        order = np.arange(coefficients.shape[-1])
        basis = np.cos(order * np.arccos(np.clip((x - self.mean) / self.half, -1.0, 1.0))[..., None])
        log_f = np.sum(coefficients * basis, axis=-1) + x * (self.sigma_rel**2 - sigma_rel**2)
        F: Real = x * np.exp(log_f)
        return np.where(F < _SMALLEST, 0.0, F)

    def error(self, frequency: Real) -> float:
        """The relative error of the interpolation at ``frequency`` [cycles/mm], by the last of its coefficients."""
        return float(np.abs(self._coefficients(frequency)[..., -2:]).max())

    def _coefficients(self, frequency: Real) -> Real:
        """Of the Chebyshev polynomials whose sum is ln(F/x) at ``frequency``, along a last axis."""
        nodes = self.weight.shape[1]
        points = chebyshev.chebpts1(nodes)
        z = np.asarray(frequency)[..., None] ** 2 / (2.0 * self.variance)
        density = np.exp(-z) @ (self.weight / (2.0 * math.pi * self.variance[:, None]))
        values = np.log(np.maximum(density, _SMALLEST) / (self.mean + self.half * points))
        share = np.full(nodes, 2.0 / nodes)
        share[0] = 1.0 / nodes
        coefficients: Real = values @ chebyshev.chebvander(points, nodes - 1) * share
        return coefficients


def transform_family(surface: Surface, wavelength: float, K: tuple[float, float], highest: float) -> TransformFamily:
    """The family for phases per height between the two ``K`` [rad/mm], up to the ``highest`` frequency [cycles/mm].

    ``wavelength`` [mm]. Raises MixtureError for spectra both steep and rough.
    """
    low, high = K[0] ** 2, K[1] ** 2
    sigma_rel = relative_rms(surface, wavelength)
    variance, step = variances(highest, scatter_terms(surface, K[1]), high * sigma_rel**2)
    knees = [1e-2 / term.B for term in surface.psd]
    probes = np.geomspace(min(*knees, highest), highest, 100)
    mean, half = 0.5 * (low + high), 0.5 * (high - low)
    for nodes in _NODES:
        squares = mean + half * chebyshev.chebpts1(nodes)
        mixtures = [
            resolved(probes, variance, step, scatter_terms(surface, math.sqrt(x)), x * sigma_rel**2) for x in squares
        ]
        weight = np.stack([mixture.weight for mixture in mixtures], axis=1)
        family = TransformFamily(mean, half, weight, variance, sigma_rel)
        if family.error(probes) < _ERROR:
            return family
    raise MixtureError(
        "the scatter changes too fast with the scattering angle to be interpolated: its phase variance reaches "
        f"{high * sigma_rel**2:.4g}"
    )
