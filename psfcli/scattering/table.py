"""Profiles of a BSDF as a table: what is printed, and what is written."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from psfcli.scattering.profile import RANGES, Profile

_COLUMNS = (
    "surface", "wavelength_nm", "incidence_deg", "plane_deg", "theta_s_deg", "beta_minus_beta_0", "bsdf_per_sr",
    "ars_per_sr", "departure",
)  # fmt: skip
_RESOLVED = 1e-8  # what a BSDF is good to


def csv_text(profiles: Sequence[Profile]) -> str:
    """One row per surface, incidence and direction; the departure is empty where there is none."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for profile in profiles:
        incidence = profile.scatter.incidence
        angles = math.degrees(incidence.angle), math.degrees(profile.plane)
        columns = profile.theta_s * math.degrees(1.0), profile.offset, profile.bsdf, profile.ars, profile.departure
        rows = list(zip(*(column.tolist() for column in columns), strict=True))
        for name in profile.surfaces:
            start = [name, repr(1e6 * incidence.wavelength), *map(repr, angles)]
            writer.writerows([*start, *("" if math.isnan(value) else repr(value) for value in row)] for row in rows)
    return stream.getvalue()


def text_table(profiles: Sequence[Profile]) -> str:
    """One line per surface and incidence: roughness, TIS, and how far from shift-invariant."""
    names = [" and ".join(profile.surfaces) for profile in profiles]
    width = max(len("surface"), *map(len, names))
    ranges = "".join(f"  within {limit:5g}" for limit in RANGES)
    lines = [f"{'surface':{width}}  theta_i [deg]  sigma_rel [nm]         g       TIS      dTIS         R{ranges}"]
    for name, profile in zip(names, profiles, strict=True):
        incidence = profile.scatter.incidence
        lines.append(
            f"{name:{width}}  {math.degrees(incidence.angle):13.6g}  {1e6 * profile.scatter.sigma_rel:14.6g}  "
            f"{incidence.g:8.5g}  {incidence.tis:8.5g}  {profile.tis_change:+8.1e}  "
            f"{profile.scatter.renormalisation:8.6f}"
            + "".join(f"  {_told(profile.largest_departure(limit)):>12}" for limit in RANGES)
        )
    return "\n".join(lines)


def _told(departure: float) -> str:
    if math.isnan(departure):
        return "-"
    return f"{departure:.1e}" if departure > _RESOLVED else f"< {_RESOLVED:.0e}"
