"""Ensquared energies by convolution and by Monte Carlo side by side, and what their differences say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from psfcli.montecarlo.estimate import BATCHES, Estimate
from psfcli.telescope.system import Field

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

CENTRES = ("gaussian", "chief", "centroid")
FALSE_ALARM = 1e-3
"""How often a faultless validation may find a disagreement."""

_RARE = 25.0  # rays expected in the rarer of inside and outside; below, their own scatter says too little


@dataclass(frozen=True, slots=True)
class Comparison:
    """One image: energies in squares of ``half_width`` [mm], each array of shape [centre, box], centres as CENTRES.

    ``told`` [box] is what the convolution may be off by its own account; boxes that are not ``judged`` [box] lie too
    near the horizon of a surface.
    """

    wavelength: float
    field: Field
    half_width: Real
    convolution: Real
    told: Real
    estimate: Estimate
    judged: Mask

    @property
    def difference(self) -> Real:
        """Monte Carlo less convolution."""
        return self.estimate.energy - self.convolution

    @property
    def excess(self) -> Real:
        """The size of the difference beyond what the convolution tells of itself."""
        return np.maximum(np.abs(self.difference) - self.told, 0.0)

    @property
    def standard_error(self) -> Real:
        """That of the estimate; of few rays in or out of a box, what their expected number makes it if that is more."""
        rays = self.estimate.rays
        expected = rays * np.maximum(np.minimum(self.convolution, 1.0 - self.convolution), 0.0)
        floor = (1.0 + np.sqrt(np.minimum(expected, _RARE))) / rays
        return np.maximum(self.estimate.standard_error, floor)

    @property
    def deviation(self) -> Real:
        """The excess in standard errors, with the sign of the difference."""
        return np.copysign(self.excess, self.difference) / self.standard_error

    @property
    def largest_deviation(self) -> float:
        """Of the boxes judged, the largest deviation [standard errors]."""
        return float(np.max(np.abs(self.deviation[:, self.judged]), initial=0.0))


@dataclass(frozen=True, slots=True)
class Criterion:
    """When a box agrees: its excess is below ``deviations`` standard errors, or below ``bound`` of all light."""

    deviations: float
    bound: float = 0.0

    def agreeing(self, comparison: Comparison) -> Mask:
        """Which boxes agree, shape [centre, box], whether judged or not."""
        return comparison.excess <= np.maximum(self.deviations * comparison.standard_error, self.bound)

    def verdicts(self, comparison: Comparison) -> NDArray[np.str_]:
        """A word on each box, shape [centre, box]."""
        words = np.where(self.agreeing(comparison), "agrees", "differs")
        return np.where(comparison.judged, words, "not judged")


@dataclass(frozen=True, slots=True)
class Extreme:
    """The ``largest`` deviation [standard errors] of ``boxes``, and the ``limit`` that chance exceeds in FALSE_ALARM.

    ``chance`` is the probability of one as large or larger in any of the boxes without a fault: at most so much, since
    boxes that share rays are counted as if they did not.
    """

    largest: float
    boxes: int
    chance: float
    limit: float

    @property
    def explained(self) -> bool:
        """Whether chance explains all differences."""
        return self.largest <= self.limit

    @property
    def criterion(self) -> Criterion:
        """What each box has to keep for all to be explained."""
        return Criterion(self.limit)


def extreme(comparisons: Sequence[Comparison]) -> Extreme:
    """The most extreme of all deviations, against Student's t of BATCHES - 1 degrees of freedom by Sidak's rule.

    Of n boxes none deviates by more than t with the probability [1 - 2 P(T < -t)]^n, were they independent: boxes that
    share rays are less often extreme, so that a false alarm is rarer than FALSE_ALARM. Nothing judged deviates by 0.
    """
    largest = max((c.largest_deviation for c in comparisons), default=0.0)
    boxes = max(sum(int(c.judged.sum()) * len(CENTRES) for c in comparisons), 1)
    of_one = 2.0 * float(special.stdtr(BATCHES - 1, -largest))
    limit = -float(special.stdtrit(BATCHES - 1, 0.5 * -math.expm1(math.log1p(-FALSE_ALARM) / boxes)))
    chance = -math.expm1(boxes * math.log1p(-of_one)) if of_one < 1.0 else 1.0
    return Extreme(largest, boxes, chance, limit)
