"""Third-order (Seidel) aberrations: wavefront and transverse ray error (Choi & Harvey 2012, Eq. 2-5)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True, slots=True)
class SeidelTable:
    """Wavefront coefficients at the pupil rim and full field, as lengths [mm].

    ``W020`` is defocus (Table 1 of the paper; it does not scale with field); ``W220`` is Hopkins' field
    curvature, the whole coefficient of H^2 rho^2, not Petzval's part alone.
    """

    W020: float = 0.0
    W040: float = 0.0
    W131: float = 0.0
    W222: float = 0.0
    W220: float = 0.0
    W311: float = 0.0

    @staticmethod
    def total(tables: Iterable[SeidelTable]) -> SeidelTable:
        """The system's table: the sum of the surfaces' tables in normalised coordinates (Eq. 3, 5) [mm]."""
        listed = list(tables)
        return SeidelTable(*(sum(getattr(t, f.name) for t in listed) for f in fields(SeidelTable)))
