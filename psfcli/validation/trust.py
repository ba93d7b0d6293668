"""Where the convolution can be trusted, by exact rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from psfcli.validation.comparison import Comparison, Criterion

EXACT = Criterion(deviations=3.0, bound=5e-4)
"""A box differs where the difference exceeds three standard errors and 5e-4 of all light."""


@dataclass(frozen=True, slots=True)
class Trust:
    """One image, boxes about the Gaussian image point: all judged ones of ``smallest`` half width [mm] or more agree.

    ``smallest`` is None where the largest one differs; ``worst`` is the largest difference, at half width ``at`` [mm].
    """

    smallest: float | None
    worst: float
    at: float


def trust(comparison: Comparison) -> Trust:
    """How far down in half width one image can be trusted; it must have a box that is judged."""
    judged = np.flatnonzero(comparison.judged)
    agrees, difference = EXACT.agreeing(comparison)[0, judged], comparison.difference[0, judged]
    wrong = np.flatnonzero(~agrees)
    first = int(wrong[-1]) + 1 if wrong.size else 0
    worst = int(np.abs(difference).argmax())
    width = comparison.half_width[judged]
    return Trust(float(width[first]) if first < judged.size else None, float(difference[worst]), float(width[worst]))
