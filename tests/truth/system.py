"""The numbers that define a case."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple


class Term(NamedTuple):
    """One K-correlation term: rms over all spatial frequencies [mm], knee length B [mm], slope C."""

    sigma: float
    B: float
    C: float


class RoughSurface(NamedTuple):
    """A surface's phase factor K = 2 pi (cos_i + cos_s)/lambda [rad/mm], its d_j [mm] and its terms, which add.

    ``index`` n' of the medium the light goes on in: roughness below n'/lambda scatters.
    """

    K: float
    d: float
    terms: tuple[Term, ...]
    index: float = 1.0

    def beyond(self, wavelength: float) -> list[float]:
        """[1 + (B n'/lambda)^2]^((1-C)/2) per term: the share of its variance beyond the horizon."""
        return [math.exp(0.5 * (1.0 - t.C) * math.log1p((t.B * self.index / wavelength) ** 2)) for t in self.terms]


@dataclass(frozen=True)
class TruthSystem:
    """A telescope with rough surfaces, at one wavelength and one field point.

    ``wavelength`` [mm]; ``surfaces``: ((K, d, ((sigma, B, C), ...), index or nothing), ...), see ``RoughSurface`` and
    ``Term``; ``image_slope`` u' [1]; ``obscuration`` the annulus' inner radius; ``seidel``: any of W020, W040, W131,
    W222, W220, W311 as lengths [mm] at the rim and H = 1; ``field`` the normalised field vector (H_x, H_y), or a number
    for (0, H). Smooth surfaces, and those at an image (d = 0, whose scatter falls on the specular image), are dropped;
    ``sector``: lit azimuths (first, last) [rad] from +x towards +y, None for all.
    """

    wavelength: float
    surfaces: tuple = ()
    image_slope: float = 0.1
    obscuration: float = 0.0
    seidel: dict = field(default_factory=dict)
    field: tuple = (0.0, 0.0)
    sector: tuple | None = None

    def __post_init__(self) -> None:
        unknown = set(self.seidel) - {"W020", "W040", "W131", "W222", "W220", "W311"}
        if unknown:
            raise ValueError(f"no such Seidel terms: {sorted(unknown)}")
        named = (
            RoughSurface(K, d, tuple(Term(*map(float, t)) for t in terms), *index)
            for K, d, terms, *index in self.surfaces
        )
        rough = tuple(s for s in named if s.d > 0.0 and any(t.sigma > 0.0 for t in s.terms))
        object.__setattr__(self, "surfaces", rough)
        if not isinstance(self.field, tuple):
            object.__setattr__(self, "field", (0.0, float(self.field)))

    def but(self, **changes: object) -> TruthSystem:
        """The same case with some numbers changed."""
        return replace(self, **changes)


def mirror(wavelength: float, d: float, *terms: tuple[float, float, float]) -> RoughSurface:
    """A mirror near normal incidence: K = 4 pi/lambda. ``terms`` are (sigma [mm], B [mm], C)."""
    return RoughSurface(4.0 * math.pi / wavelength, d, tuple(Term(*t) for t in terms))


def phase_variance(wavelength: float, surface: RoughSurface) -> float:
    """g = K^2 sigma_rel^2, sigma_rel^2 = sum sigma^2 {1 - [1 + (B n'/lambda)^2]^((1-C)/2)}."""
    return surface.K**2 * math.fsum(
        t.sigma**2 * -math.expm1(0.5 * (1.0 - t.C) * math.log1p((t.B * surface.index / wavelength) ** 2))
        for t in surface.terms
    )


def sigma_for_phase_variance(g: float, K: float, wavelength: float, B: float, C: float) -> float:
    """The full-spectrum rms [mm] of the single term whose part below 1/lambda gives the phase variance ``g``."""
    return math.sqrt(g / phase_variance(wavelength, RoughSurface(K, 1.0, (Term(1.0, B, C),))))


def specular_weight(system: TruthSystem) -> float:
    """exp(-sum of g): the fraction of the light that no surface scatters."""
    return math.exp(-math.fsum(phase_variance(system.wavelength, s) for s in system.surfaces))
