"""Writes values.csv: first-order vector perturbation theory (Rayleigh-Rice) by SCATMECH, of NIST.

Needs pySCATMECH (0.1.10 made what is here; it is compiled for minutes when installed), which is no dependency of the
tests: ``python tests/scatmech/make.py`` in an environment that has it.

Microroughness_BRDF_Model on a nearly perfect conductor, n = 1e7 (1 + i), whose own reflectance differs from 1 by 2e-7;
ABC spectrum of A = 1e-4 um^4, B = 20 um, C = 2.8 (of the two-dimensional spectrum) at 0.6328 um. s-polarised light in
and out: ``brdf_ss`` in 1/sr, phi_s = 0 the half plane of the specular direction.
"""

import csv
import math
from pathlib import Path

ANGLES = [(0, 1), (0, 30), (0, 75), (5, 6), (20, 20.5), (30, 10), (30, -40), (45, 80), (60, 60.5), (60, -20), (80, 50)]
OUT_OF_PLANE = [(5, 10, 30), (30, 30, 40), (60, 20, 120)]


def main():
    """Compute and write the values."""
    from pySCATMECH.brdf import BRDF_Model

    spectrum = {None: "ABC_PSD_Function", "A": "1e-4", "B": "20", "C": "2.8"}
    model = BRDF_Model(
        "Microroughness_BRDF_Model", {"lambda": 0.6328, "substrate": "(1e7,1e7)", "type": 0, "psd": spectrum}
    )
    with (Path(__file__).parent / "values.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["theta_i_deg", "theta_s_deg", "phi_s_deg", "brdf_ss"])
        for angles in [(i, s, 0) for i, s in ANGLES] + OUT_OF_PLANE:
            M = model.MuellerBRDF(*map(math.radians, angles))
            writer.writerow([*angles, repr(0.5 * float(M[0, 0] + M[0, 1] + M[1, 0] + M[1, 1]))])


if __name__ == "__main__":
    main()
