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
        return cls(rms / math.sqrt(cls(1.0, B, C).band_share(f1, f2)), B, C)

    def band_variance(self, f1: float, f2: float) -> float:
        """Variance [mm^2] between spatial frequencies ``f1`` < ``f2`` [cycles/mm], f2 may be infinite."""
        return self.sigma**2 * self.band_share(f1, f2)

    def band_share(self, f1: float, f2: float) -> float:
        """The share [1] of the variance that lies between ``f1`` < ``f2`` [cycles/mm], f2 may be infinite.

        [1 + (B f1)^2]^((1-C)/2) - [1 + (B f2)^2]^((1-C)/2), without cancellation for narrow bands or for C near 1:
        relative error 1e-14 max(1, C/100) while (B f1)^(1-C) is a normal double.
        """
        nu = (self.C - 1.0) / 2.0
        knee = math.hypot(1.0, self.B * f1)  # [1 + (B f1)^2]^(1/2)
        narrow, wide = self.B * (f2 - f1) / knee, self.B * (f2 + f1) / knee
        # the logarithm of [1 + (B f2)^2]/[1 + (B f1)^2], which is 1 + narrow wide
        rise = math.log1p(narrow * wide) if wide < 1e8 else math.log(narrow) + math.log(wide)
        return knee ** (-2.0 * nu) * -math.expm1(-nu * rise)
