"""The SYNTHETIC spectra in configs/metrology/: what four instruments might measure of one polished mirror.

Usage: python scripts/metrology_sample.py

Drawn from the stand-in of configs/euv_two_mirror.yaml (sigma 0.682 nm, B 1 mm, C 1.8), each spectrum the mean of a few
periodograms (gamma distributed) times a gain of the instrument. No mirror was measured.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from psfcli.metrology.measurement import KINDS
from psfcli.metrology.spectrum import log_density

DIRECTORY = Path(__file__).resolve().parent.parent / "configs" / "metrology"
LN_A, B, C = np.log(2.5285e-13), 1.0, 1.8  # sigma 0.682 nm
GAIN = 0.1
INSTRUMENTS = (  # name, kind, units of frequency and psd, one of them inside in these, band, points, averages
    ("interferometer", "2d", "1/mm", "nm2 mm2", (1.0, 1e12), (0.02, 2.0), 60, 6.0),
    ("microscope_2x5", "1d one-sided", "1/mm", "nm2 mm", (1.0, 1e12), (0.5, 50.0), 60, 8.0),
    ("microscope_50x", "1d two-sided", "1/um", "nm3", (1e-3, 1e18), (8.0, 800.0), 60, 5.0),
    ("afm", "2d", "1/um", "nm4", (1e-3, 1e24), (200.0, 5e4), 80, 7.0),
)


def main() -> None:
    """Write the four files."""
    rng = np.random.default_rng(2012)
    DIRECTORY.mkdir(exist_ok=True)
    for name, kind, frequency_unit, psd_unit, (per_mm, per_inside), band, points, averages in INSTRUMENTS:
        f = np.geomspace(*band, points)
        log_psd = log_density(f, np.full(points, KINDS.index(kind)), np.array([[LN_A, np.log(B), C]]))[0]
        noise = np.exp(GAIN * rng.normal()) * rng.gamma(averages, 1.0 / averages, points)
        rows = zip(f * per_mm, np.exp(log_psd) * noise * per_inside, strict=True)
        head = (
            f"# SYNTHETIC, made by scripts/metrology_sample.py: no mirror was measured\n# instrument: {name}\n"
            f"# kind: {kind}\nfrequency [{frequency_unit}],psd [{psd_unit}]\n"
        )
        text = head + "".join(f"{frequency:.6g},{psd:.6g}\n" for frequency, psd in rows)
        (DIRECTORY / f"{name}.csv").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
