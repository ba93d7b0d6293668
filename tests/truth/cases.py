"""The paper's telescope (Choi & Harvey 2012, Sec. 4) and the three reference cases, as plain numbers."""

from __future__ import annotations

import csv
from pathlib import Path

from .system import TruthSystem, mirror, sigma_for_phase_variance

WAVELENGTH = 9.4e-6
IMAGE_SLOPE = 95.0 / 1750.0
DISTANCES = (1750.0, 34.9885 / IMAGE_SLOPE)
SEIDEL = {
    name: waves * WAVELENGTH
    for name, waves in {
        "W020": -30.35, "W040": 0.42, "W131": -7.60, "W222": 48.34, "W220": 38.58, "W311": -5.48,
    }.items()
}  # fmt: skip


def paper_telescope(*terms: tuple[float, float, float], field: float = 0.0, seidel: dict | None = None) -> TruthSystem:
    """Two mirrors with the same ``terms`` (sigma [mm], B [mm], C), at H = ``field``."""
    surfaces = tuple(mirror(WAVELENGTH, d, *terms) for d in DISTANCES)
    return TruthSystem(WAVELENGTH, surfaces, IMAGE_SLOPE, 0.48, SEIDEL if seidel is None else seidel, field)


def one_mirror(g: float, B: float, C: float, distance: float = 1000.0, wavelength: float = 1e-5) -> TruthSystem:
    """A single mirror of phase variance ``g`` without aberrations; lambda d = 0.01 mm^2 unless told."""
    K = mirror(wavelength, distance).K
    term = (sigma_for_phase_variance(g, K, wavelength, B, C), B, C)
    return TruthSystem(wavelength, (mirror(wavelength, distance, term),))


REFERENCE = {
    "euv_field0": paper_telescope((6.820358828624745e-7, 1.0, 1.8), field=0.0),
    "euv_field05": paper_telescope((6.820358828624745e-7, 1.0, 1.8), field=1.0),
    "euv_noaberr_C2": paper_telescope((6.820066326860538e-7, 1.0, 2.0), seidel={}),
}


def reference_rows(name: str) -> list[dict[str, float]]:
    """The rows of reference/NAME.csv, half widths in um."""
    with (Path(__file__).parent / "reference" / f"{name}.csv").open(newline="") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
