"""Whether the data decide the parameters of a fit; what they leave open is told, not guessed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from psfcli.metrology.problem import SLOPES, Problem
from psfcli.metrology.spectrum import PER_TERM

Real = NDArray[np.float64]

KNEE_ERROR = 0.7
"""Standard error of ln B up to which a knee is resolved: 95 % intervals within a factor of four of B."""
SLOPE_ERROR = 0.3
"""Relative standard error of C up to which a slope is resolved."""
AMPLITUDE_ERROR = 1.4
"""Standard error of ln A up to which an amplitude is resolved: the rms within a factor of four."""
_ONE_SIDED_95 = 2.706  # chi-square above its least at a limit of 95 %


class FitError(Exception):
    """Spectra that no K-correlation can be fitted to, or that leave one of its parameters open."""


def check_resolved(problem: Problem, parameters: Real, weight: Real, bias: Real) -> None:
    """Raise FitError unless the data bound the knee and the slope of every term.

    ``weight`` and ``bias`` [instrument] are those of the fit. A limit that is told has a confidence of 95 %: chi-square
    rises by 2.706 there, all other parameters fitted anew.
    """
    errors = np.sqrt(np.diag(problem.covariance(parameters, weight)))
    for j in range(problem.terms):
        at = PER_TERM * j + 1
        ln_B, C = parameters[at], parameters[at + 1]
        knee_error, slope_error = errors[at], errors[at + 1] / C
        open_end = not SLOPES[0] + 1e-6 < C < SLOPES[1] - 1e-3
        resolved = knee_error < KNEE_ERROR and slope_error < SLOPE_ERROR and errors[at - 1] < AMPLITUDE_ERROR
        if resolved and not open_end:
            continue
        if problem.terms > 1:
            raise FitError(
                f"the data do not resolve {problem.terms} terms: of the one with its knee near {math.exp(-ln_B):.3g} "
                f"cycles/mm, B is known to a factor of {_factor(knee_error)} and C to {_share(slope_error)}; ask for "
                "fewer terms"
            )
        low, high = problem.frequency.min(), problem.frequency.max()
        if ln_B < -math.log(high):
            B = math.exp(_limit(problem, parameters, weight, bias, at, 1.0))
            raise FitError(
                f"no slope in the data: the spectrum is nearly flat up to {high:.3g} cycles/mm; B is below {B:.3g} mm "
                f"(95 %), C open; add a file that reaches frequencies well above {1.0 / B:.2g} cycles/mm"
            )
        if SLOPES[0] + 1e-6 >= C and slope_error < SLOPE_ERROR:
            raise FitError(
                f"up to {high:.3g} cycles/mm the one-dimensional spectrum falls no faster than 1/f: C = {C:.2f} +- "
                f"{errors[at + 1]:.2f} where it must be above 1, or the rms over all spatial frequencies is infinite"
            )
        if open_end and SLOPES[0] + 1e-6 < C:
            raise FitError(
                f"beyond its knee the spectrum falls faster than a K-correlation of C = {SLOPES[1]:g}, as a Gaussian; "
                "files that reach higher frequencies would show its slope"
            )
        if not open_end and 2.0 * ln_B > -math.log(low * high):
            B = math.exp(_limit(problem, parameters, weight, bias, at, -1.0))
            raise FitError(
                f"no knee in the data: from {low:.3g} cycles/mm on the spectrum falls as a power of f, and any B above "
                f"{B:.3g} mm fits (95 %); add a file that reaches frequencies below {1.0 / B:.2g} cycles/mm"
            )
        raise FitError(
            f"the data do not resolve a K-correlation: B = {math.exp(ln_B):.3g} mm is known to a factor of "
            f"{_factor(knee_error)} and C = {C:.3g} to {_share(slope_error)}; add files of other bands"
        )


def _limit(problem: Problem, parameters: Real, weight: Real, bias: Real, at: int, side: float) -> float:
    """The ln B on a ``side`` (-1 or 1) of the best one at which chi-square has risen by _ONE_SIDED_95."""
    edges = [edge[at] for edge in problem.bounds()]
    least = problem.solve(parameters, weight, bias)[1]

    def rise(ln_B: float) -> float:
        there = parameters.copy()
        there[at] = ln_B
        return problem.solve(there, weight, bias, fixed=at)[1] - least - _ONE_SIDED_95

    end = edges[0] if side < 0.0 else edges[1]
    if rise(end) < 0.0:
        return end
    return float(optimize.brentq(rise, parameters[at], end, xtol=1e-3))


def _factor(error: float) -> str:
    return f"{math.exp(2.0 * error):.2g}" if error < 5.0 else "thousands"


def _share(error: float) -> str:
    return f"{200.0 * error:.2g} %" if error < 5.0 else "nothing"
