"""How far two arrays are apart, against what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from psfcli.tolerance import Tolerance

    Values = NDArray[np.float64]


ROUND_OFF = 1e-9
"""Relative difference allowed between numbers that carry no promise: far above round-off, far below any use."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest differences between the two versions of ``name``, an HDU, a column or a card.

    ``absolute``; ``relative`` to the larger of the two values; ``share`` of what is allowed (up to 1 is within).
    ``beyond`` of the ``values`` differ by more than allowed. Infinite where the values are not numbers.
    """

    name: str
    absolute: float = 0.0
    relative: float = 0.0
    share: float = 0.0
    beyond: int = 0
    values: int = 0

    def joined(self, other: Difference) -> Difference:
        """The difference of both parts of one array."""
        return Difference(
            self.name,
            max(self.absolute, other.absolute),
            max(self.relative, other.relative),
            max(self.share, other.share),
            self.beyond + other.beyond,
            self.values + other.values,
        )


def difference(
    name: str, a: Values, b: Values, *, relative: float = 0.0, absolute: Values | float = 0.0, floor: float = 0.0
) -> Difference:
    """The difference of two arrays of one shape: allowed is ``relative`` times the larger value plus ``absolute``.

    Where both are at most ``floor`` in size nothing more is asked. A value that is not a number is beyond
    whatever is allowed; equal infinities are equal.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        apart = np.where(a == b, 0.0, np.abs(a - b))
        larger = np.maximum(np.abs(a), np.abs(b))
        allowed = relative * larger + absolute
        judged = (apart != 0.0) & ~(larger <= floor)
        beyond = judged & ~(apart <= allowed)
        return Difference(
            name,
            _largest(apart),
            _largest(apart[judged] / larger[judged]),
            _largest(apart[judged] / allowed[judged]),
            int(np.count_nonzero(beyond)),
            a.size,
        )


def ensquared_difference(name: str, column: str, a: Values, b: Values, tolerance: Tolerance) -> Difference:
    """The difference of one ``column`` of a table of ensquared energies: ``ee`` for energies, else round-off."""
    if column.startswith("ee"):
        return difference(name, a, b, absolute=tolerance.ee)
    return difference(name, a, b, relative=ROUND_OFF)


def mismatch(name: str, a: NDArray[Any], b: NDArray[Any]) -> Difference:
    """The difference of two arrays of text: equal, or beyond."""
    unequal = int(np.count_nonzero(a != b))
    apart = np.inf if unequal else 0.0
    return Difference(name, apart, apart, apart, unequal, a.size)


def _largest(values: Values) -> float:
    """The largest of the values, infinite if any is not a number; 0 for none."""
    largest = float(np.max(values, initial=0.0))
    return np.inf if np.isnan(largest) else largest
