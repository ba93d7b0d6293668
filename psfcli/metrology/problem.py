"""The least-squares problem of a fit: residuals of all instruments in the logarithm, and a prior for their gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from psfcli.metrology.measurement import KINDS, Measurement
from psfcli.metrology.spectrum import PER_TERM, log_density

Real = NDArray[np.float64]

SLOPES = 1.0001, 1000.0
"""Slopes C that are tried; at the first the roughness hardly converges, the last is a Gaussian spectrum."""
_BEYOND = 1e3  # knees are tried so far beyond the band


@dataclass(frozen=True)
class Problem:
    """ln P_ik = ln S(f_ik) + gain_i + bias_i + noise of scatter s_i for point k of instrument i, gain_i ~ N(0, g^2).

    Parameters are those of the terms [3 term], then, unless ``gain_error`` g is 0, the gains [instrument].
    """

    measurements: Sequence[Measurement]
    terms: int
    gain_error: float

    @cached_property
    def frequency(self) -> Real:
        """All frequencies [cycles/mm], instrument by instrument."""
        return np.concatenate([m.frequency for m in self.measurements])

    @cached_property
    def log_measured(self) -> Real:
        """The logarithms of all densities."""
        return np.log(np.concatenate([m.density for m in self.measurements]))

    @cached_property
    def owner(self) -> NDArray[np.intp]:
        """The instrument of each point."""
        return np.repeat(np.arange(len(self.measurements)), [len(m.frequency) for m in self.measurements])

    @cached_property
    def kind(self) -> NDArray[np.intp]:
        """The kind of each point, counted in KINDS."""
        return np.array([KINDS.index(m.kind) for m in self.measurements])[self.owner]

    @property
    def gains(self) -> int:
        """How many gains are parameters."""
        return len(self.measurements) if self.gain_error else 0

    def log_model(self, parameters: Real) -> tuple[Real, Real]:
        """Ln S + gain at each point [n], and its derivatives [n, parameter]."""
        shape = PER_TERM * self.terms
        value, slopes = log_density(self.frequency, self.kind, parameters[:shape].reshape(-1, PER_TERM))
        if not self.gains:
            return value, slopes
        return value + parameters[shape:][self.owner], np.hstack([slopes, np.eye(self.gains)[self.owner]])

    def jacobian(self, parameters: Real, scatter: Real) -> Real:
        """Derivatives of the weighted residuals [point + gain, parameter]; ``scatter`` [instrument]."""
        rows = -self.log_model(parameters)[1] / scatter[self.owner, None]
        prior = np.eye(parameters.size)[parameters.size - self.gains :] / (self.gain_error or 1.0)
        return np.vstack([rows, prior])

    def residuals(self, parameters: Real, scatter: Real, bias: Real) -> Real:
        """Weighted residuals [point + gain], whose squares add up to chi-square; ``scatter``, ``bias`` [instrument]."""
        rows = (self.log_measured - bias[self.owner] - self.log_model(parameters)[0]) / scatter[self.owner]
        return np.concatenate([rows, parameters[parameters.size - self.gains :] / (self.gain_error or 1.0)])

    def covariance(self, parameters: Real, scatter: Real) -> Real:
        """The inverse of J^T J [parameter, parameter], columns of J scaled to length 1; infinite where singular."""
        J = self.jacobian(parameters, scatter)
        length = np.linalg.norm(J, axis=0)
        if not np.all(length > 0.0):
            return np.full((length.size, length.size), math.inf)
        try:
            inverse = np.linalg.inv(np.linalg.qr(J / length)[1])
        except np.linalg.LinAlgError:
            return np.full((length.size, length.size), math.inf)
        return (inverse @ inverse.T) / np.outer(length, length)

    def bounds(self) -> tuple[Real, Real]:
        """The least and the largest value of each parameter."""
        knees = -math.log(_BEYOND * self.frequency.max()), -math.log(self.frequency.min() / _BEYOND)
        one = [(-math.inf, math.inf), knees, SLOPES] * self.terms + [(-math.inf, math.inf)] * self.gains
        edges = np.array(one)
        return edges[:, 0], edges[:, 1]

    def solve(
        self, start: Real, scatter: Real, bias: Real, fixed: int | None = None, effort: int = 300
    ) -> tuple[Real, float]:
        """The parameters of least chi-square near ``start``, and it; ``fixed`` is the index of one that stays.

        ``effort`` bounds the evaluations.
        """
        free = np.arange(start.size) != (-1 if fixed is None else fixed)
        low, high = (edge[free] for edge in self.bounds())

        def whole(some: Real) -> Real:
            parameters = start.copy()
            parameters[free] = some
            return parameters

        found = optimize.least_squares(
            lambda some: self.residuals(whole(some), scatter, bias),
            np.clip(start[free], low + 1e-9, high - 1e-9),
            jac=lambda some: self.jacobian(whole(some), scatter)[:, free],
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=effort,
        )
        return whole(found.x), 2.0 * float(found.cost)
