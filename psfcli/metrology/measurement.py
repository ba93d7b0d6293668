"""What an instrument measured: a spectrum in its band. Lengths in mm, spatial frequencies in cycles/mm."""

from __future__ import annotations

from dataclasses import dataclass

ONE_SIDED, TWO_SIDED, TWO_DIMENSIONAL = KINDS = ("1d one-sided", "1d two-sided", "2d")
"""A one-sided 1-D spectrum has its variance above f = 0, a two-sided one half of it; a 2-D one holds in the plane."""

GAIN_ERROR = 0.2
"""The standard error of an instrument's gain, as of ln S, unless another is given: a tenth of heights."""
MOST_TERMS = 4


@dataclass(frozen=True, slots=True)
class Measurement:
    """A power spectral density as one instrument measured it.

    ``kind`` is one of KINDS; ``frequency`` [cycles/mm] rises and is above 0; ``density`` [mm^3 of a 1-D, mm^4 of a 2-D
    spectrum] is above 0 and of the same length.
    """

    name: str
    kind: str
    frequency: tuple[float, ...]
    density: tuple[float, ...]

    @property
    def band(self) -> tuple[float, float]:
        """The lowest and the highest frequency [cycles/mm]."""
        return self.frequency[0], self.frequency[-1]
