"""The K-correlation (ABC) power spectral density of a polished surface and its autocovariance.

Lengths in mm, spatial frequencies in cycles/mm (no 2 pi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KCorrelation:
    """One K-correlation term, S2(f) = S0/[1 + (B f)^2]^((C+1)/2) in two dimensions.

    ``sigma`` [mm] is the rms over all spatial frequencies, ``B`` [mm] the knee's length, ``C`` > 1 the slope of
    the one-dimensional spectrum.
    """

    sigma: float
    B: float
    C: float

    @classmethod
    def from_S0(cls, S0: float, B: float, C: float) -> KCorrelation:
        """The term with two-dimensional spectrum ``S0`` [mm^4] at f = 0: sigma^2 = 2 pi S0/((C-1) B^2)."""
        return cls(math.sqrt(2.0 * math.pi * S0 / (C - 1.0)) / B, B, C)

    @classmethod
    def from_A(cls, A: float, B: float, C: float) -> KCorrelation:
        """The term with one-sided one-dimensional spectrum A/[1 + (B f)^2]^(C/2), ``A`` [mm^3].

        S0 = K A B with K = Gamma((C+1)/2)/(2 sqrt(pi) Gamma(C/2)), which belongs to a one-sided spectrum.
        """
        K = math.exp(math.lgamma((C + 1.0) / 2.0) - math.lgamma(C / 2.0)) / (2.0 * math.sqrt(math.pi))
        return cls.from_S0(K * A * B, B, C)

    @classmethod
    def from_band_rms(cls, rms: float, f1: float, f2: float, B: float, C: float) -> KCorrelation:
        """The term whose rms between ``f1`` and ``f2`` [cycles/mm] is ``rms`` [mm]."""
        return cls(rms / math.sqrt(cls(1.0, B, C).band_variance(f1, f2)), B, C)

    def band_variance(self, f1: float, f2: float) -> float:
        """Variance [mm^2] between spatial frequencies ``f1`` < ``f2`` [cycles/mm], f2 may be infinite.

        sigma^2 {[1 + (B f1)^2]^((1-C)/2) - [1 + (B f2)^2]^((1-C)/2)}, without cancellation for narrow bands.
        """

        def log_knee(f: float) -> float:  # ln[1 + (B f)^2], free of overflow
            bf = self.B * f
            return math.log1p(bf * bf) if bf < 1e8 else 2.0 * math.log(bf)

        half = (self.C - 1.0) / 2.0
        low = log_knee(f1)
        return self.sigma**2 * math.exp(-half * low) * -math.expm1(-half * (log_knee(f2) - low))
