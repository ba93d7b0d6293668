"""The K-correlation that fits measured spectra, with what is known of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.metrology.measurement import GAIN_ERROR, Measurement
from psfcli.metrology.noise import LEAST_SCATTER, averages, log_bias, points_per_independent
from psfcli.metrology.problem import Problem
from psfcli.metrology.resolution import FitError, check_resolved
from psfcli.metrology.search import start
from psfcli.metrology.spectrum import PER_TERM, k_correlations
from psfcli.surface.psd import KCorrelation

Real = NDArray[np.float64]

_ROUNDS = 100
_NEARLY, _SETTLED = 1e-2, 1e-7  # change of ln scatter from round to round


@dataclass(frozen=True, slots=True)
class Instrument:
    """A measurement beside its fit.

    ``log_gain`` is ln of its gain, with the standard error ``gain_error`` (both 0 without gains); ``scatter`` the
    standard deviation of ln S about the fit; ``correlated`` the number of neighbours that count as one point;
    ``log_fit`` [n] the logarithm of the fitted spectrum, gain and bias apart, in the kind measured.
    """

    measurement: Measurement
    log_gain: float
    gain_error: float
    scatter: float
    correlated: float
    log_fit: Real

    @property
    def averages(self) -> float:
        """How many averaged periodograms scatter so."""
        return float(averages(np.asarray(self.scatter)))

    @property
    def log_bias(self) -> float:
        """The mean of ln S measured less ln S, that goes with the scatter."""
        return float(log_bias(np.asarray(self.scatter)))

    @property
    def log_residuals(self) -> Real:
        """Ln of measured by fitted [n], gain and bias taken off."""
        return np.log(self.measurement.density) - self.log_fit - self.log_gain - self.log_bias


@dataclass(frozen=True, slots=True)
class Fit:
    """Terms by rising knee frequency: as ``spectra``, as ``parameters`` [term, 3] and with their ``covariance``.

    A row is ln A [A in mm^3], ln B [B in mm], C; the covariance [3 term, 3 term] is in that order.
    """

    parameters: Real
    covariance: Real
    instruments: tuple[Instrument, ...]

    @property
    def spectra(self) -> tuple[KCorrelation, ...]:
        """The terms, which add."""
        return k_correlations(self.parameters)

    @property
    def errors(self) -> Real:
        """Standard errors of ``parameters`` [term, 3]."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, PER_TERM)


def least_points(terms: int) -> int:
    """The points a file must have for its own scatter to be told from the fit."""
    return PER_TERM * terms + 5


def fit(measurements: Sequence[Measurement], terms: int = 1, gain_error: float = GAIN_ERROR) -> Fit:
    """The sum of ``terms`` K-correlations that fits the ``measurements`` best, in the logarithm.

    Least is the sum of (ln P_ik - ln S(f_ik) - gain_i - bias_i)^2/(c_i s_i^2) over the points k of the instruments i,
    and of gain_i^2/``gain_error``^2 (0: no gains). S is that of ``log_density``, s_i the scatter of an instrument,
    estimated from its residuals, bias_i what ``log_bias`` makes of it, and c_i how many correlated neighbours count as
    one point (``points_per_independent``). Repeated until the scatters settle. The covariance is the inverse of the
    weighted normal matrix, which holds for errors small against the curvature of the model: what is not resolved is
    refused.

    Raises FitError, saying what the data leave open, and where a file has fewer than ``least_points``, or all have one
    frequency.
    """
    problem = Problem(measurements, terms, gain_error)
    lowest, highest = problem.frequency.min(), problem.frequency.max()
    if lowest == highest:
        raise FitError(f"all points lie at {lowest:.6g} cycles/mm; a spectrum is measured at many frequencies")
    for m in measurements:
        if len(m.frequency) < least_points(terms):
            raise FitError(
                f"{m.name}: {len(m.frequency)} points; to tell its scatter from a fit of {terms} "
                f"term{'s' * (terms > 1)} a file needs {least_points(terms)}"
            )
    count = len(measurements)
    parameters, correlated = start(problem), np.ones(count)
    parameters, scatter = _settled(problem, parameters, np.ones(count), correlated, _NEARLY)
    apart = _apart(problem, parameters, scatter)
    correlated = np.array([points_per_independent(apart[problem.owner == i]) for i in range(count)])
    parameters, scatter = _settled(problem, parameters, scatter, correlated, _SETTLED)
    weight = scatter * np.sqrt(correlated)
    check_resolved(problem, parameters, weight, log_bias(scatter))
    order = np.argsort(-parameters[1 : PER_TERM * terms : PER_TERM])
    places = np.concatenate([np.arange(PER_TERM) + PER_TERM * j for j in order])
    covariance = problem.covariance(parameters, weight)
    gains = np.zeros(count), np.zeros(count)
    if gain_error:
        gains = parameters[PER_TERM * terms :], np.sqrt(np.diag(covariance)[PER_TERM * terms :])
    log_fit = problem.log_model(parameters)[0] - gains[0][problem.owner]
    instruments = (
        Instrument(
            m, float(gains[0][i]), float(gains[1][i]), float(scatter[i]), correlated[i], log_fit[problem.owner == i]
        )
        for i, m in enumerate(measurements)
    )
    return Fit(parameters[places].reshape(-1, PER_TERM), covariance[np.ix_(places, places)], tuple(instruments))


def _settled(problem: Problem, parameters: Real, scatter: Real, correlated: Real, change: float) -> tuple[Real, Real]:
    """Parameters and scatters that belong to each other.

    s_i^2 = sum of squares/(n_i - h_i), h_i the leverage of the instrument's points: the parameters they decide.
    """
    for _ in range(_ROUNDS):
        weight = scatter * np.sqrt(correlated)
        parameters, _ = problem.solve(parameters, weight, log_bias(scatter))
        basis = np.linalg.qr(problem.jacobian(parameters, weight))[0][: problem.owner.size]
        free = 1.0 - np.sum(basis**2, axis=1)
        squares = _apart(problem, parameters, scatter) ** 2
        before = scatter
        scatter = np.sqrt(np.bincount(problem.owner, squares) / np.bincount(problem.owner, free))
        scatter = np.maximum(scatter, LEAST_SCATTER)
        if np.max(np.abs(np.log(scatter / before))) < change:
            break
    return parameters, scatter


def _apart(problem: Problem, parameters: Real, scatter: Real) -> Real:
    """Measured less fitted in the logarithm, gains and biases taken off [n]."""
    return problem.log_measured - log_bias(scatter)[problem.owner] - problem.log_model(parameters)[0]
