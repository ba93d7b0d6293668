"""Where a fit starts: one term after another, each tried with many knees and slopes."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from psfcli.metrology.measurement import KINDS, ONE_SIDED
from psfcli.metrology.problem import Problem
from psfcli.metrology.spectrum import PER_TERM, log_density

Real = NDArray[np.float64]

_KNEES = 13
_SLOPES = 1.3, 1.8, 2.5, 4.0, 8.0
_AMPLITUDES = 0.3, 3.0  # of a further term at its knee, of those before it
_TRIED = 4  # of the starts, the best
_EFFORT = 60


def start(problem: Problem) -> Real:
    """Parameters near the least chi-square with equal weights, gains 0 unless they help.

    A further term starts beside the best fit of those before it, so that more terms never fit worse.
    """
    found = np.empty((0, PER_TERM))
    even, none = np.ones(len(problem.measurements)), np.zeros(len(problem.measurements))
    for terms in range(1, problem.terms + 1):
        part = replace(problem, terms=terms)
        tried = [np.concatenate([some.ravel(), np.zeros(part.gains)]) for some in _candidates(problem, found)]
        tried.sort(key=lambda one: float(np.sum(part.residuals(one, even, none) ** 2)))
        solved = [part.solve(one, even, none, effort=_EFFORT) for one in tried[:_TRIED]]
        best = min(solved, key=lambda answer: answer[1])[0]
        found = best[: PER_TERM * terms].reshape(-1, PER_TERM)
    return best


def _candidates(problem: Problem, before: Real) -> list[Real]:
    """Terms [term, 3]: those ``before`` and one more, of many knees, slopes and amplitudes."""
    f = problem.frequency
    knees = -np.log(np.geomspace(f.min(), f.max(), _KNEES))
    one_sided = np.array([KINDS.index(ONE_SIDED)])
    tried = []
    for ln_B, C in product(knees, _SLOPES):
        if before.size:
            there = float(log_density(np.array([np.exp(-ln_B)]), one_sided, before)[0][0])
            levels = [there + np.log(share) for share in _AMPLITUDES]
        else:
            shape = log_density(f, problem.kind, np.array([[0.0, ln_B, C]]))[0]
            levels = [float(np.mean(problem.log_measured - shape))]
        tried += [np.vstack([before, [level, ln_B, C]]) for level in levels]
    return tried
