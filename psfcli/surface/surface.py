"""A polished surface: what the scatter of one mirror or lens face depends on."""

from __future__ import annotations

from dataclasses import dataclass

from psfcli.surface.psd import KCorrelation


@dataclass(frozen=True, slots=True)
class Surface:
    """One optical surface, in the order light meets them.

    ``marginal_height`` [mm]; ``psd``: K-correlation terms that add (none: perfectly smooth); ``incidence``
    [rad]; ``index_before`` and ``index_after`` are the refractive indices on either side (equal and positive
    for a mirror); ``reflectance`` enters the reported throughput only.
    """

    name: str
    marginal_height: float
    psd: tuple[KCorrelation, ...] = ()
    reflectance: float = 1.0
    incidence: float = 0.0
    is_mirror: bool = True
    index_before: float = 1.0
    index_after: float = 1.0
