"""S(r) of a few systems, once and for all: reference/halo.csv, from the contour in mpmath; ``python -m truth.halo``.

The unclipped S, at radii in units of the first surface's knee lambda d/B; the clip at the horizon is subtracted where
the table is used (``horizon.missing_psf``), as it is smooth and cheap.
"""

from __future__ import annotations

import csv
from pathlib import Path

from .cases import DISTANCES, WAVELENGTH, one_mirror
from .contour import scatter_psf_mpmath
from .system import TruthSystem, mirror, sigma_for_phase_variance

TABLE = Path(__file__).parent / "reference" / "halo.csv"


def _mirrors(*surfaces: tuple[tuple[float, float, float], ...]) -> TruthSystem:
    """Mirrors of the paper's telescope, each with terms (g, B, C)."""
    K = mirror(WAVELENGTH, 1.0).K
    rough = [
        mirror(WAVELENGTH, d, *((sigma_for_phase_variance(g, K, WAVELENGTH, B, C), B, C) for g, B, C in terms))
        for d, terms in zip(DISTANCES, surfaces, strict=False)
    ]
    return TruthSystem(WAVELENGTH, tuple(rough))


SYSTEMS = {
    **{f"C={C}": one_mirror(0.83, 1.0, C) for C in (1.2, 1.5, 1.8, 2.5, 3.0, 4.0, 6.0, 8.0)},
    "almost smooth": one_mirror(1e-6, 1.0, 1.8),
    "very rough": one_mirror(6.0, 1.0, 1.8),
    "very rough and steep": one_mirror(6.0, 1.0, 4.0),
    "coarse knee": one_mirror(0.83, 0.01, 1.5),  # B = 1000 wavelengths: 3 % of the variance beyond the horizon
    "two mirrors": _mirrors(((0.83, 1.0, 1.8),), ((0.83, 1.0, 1.8),)),
    "two rough mirrors": _mirrors(((3.0, 1.0, 1.5),), ((3.0, 1.0, 1.5),)),
    "two slopes": _mirrors(((0.5, 1.0, 1.5),), ((0.9, 1.0, 3.0),)),
    "two terms": _mirrors(((0.4, 1.0, 2.0), (0.3, 0.1, 4.0)), ((0.2, 2.0, 1.6), (0.5, 0.3, 2.5))),
}


def knee(system: TruthSystem) -> float:
    """lambda d/B of the first surface's first term [mm]."""
    first = system.surfaces[0]
    return system.wavelength * first.d / first.terms[0].B


def radii(system: TruthSystem) -> list[float]:
    """From the core to where S has fallen by more than nine decades [mm], at most 0.3 d."""
    flattest = min(t.C for s in system.surfaces for t in s.terms)
    last = 10.0 ** (11.5 / (flattest + 1.0))
    return [min(b * knee(system), 0.3 * system.surfaces[0].d) for b in (0.01, 1.0, last**0.3, last**0.6, last)]


def rows() -> list[dict[str, float | str]]:
    """The table, from disk."""
    with TABLE.open(newline="") as file:
        return [{k: v if k == "system" else float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def make() -> None:
    """Compute the table: two or three minutes."""
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["system", "r_mm", "scatter_per_mm2"])
        for name, system in SYSTEMS.items():
            for r in radii(system):
                table.writerow([name, repr(r), repr(float(scatter_psf_mpmath(system, r)))])


if __name__ == "__main__":
    make()
