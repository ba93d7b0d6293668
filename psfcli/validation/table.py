"""A validation as a table: lines for readers, CSV for programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

import numpy as np

from psfcli.config.model import System
from psfcli.products.units import DEG, NM, UM, converted, field_name
from psfcli.validation.comparison import CENTRES, Comparison, Criterion

COLUMNS = (
    "wavelength_nm",
    "field",
    "azimuth_deg",
    "centre",
    "half_width_um",
    "width_px",
    "ee_convolution",
    "ee_montecarlo",
    "difference",
    "standard_error",
    "deviation",
    "verdict",
)
_MOST_LINES = 24


def csv_text(comparisons: Sequence[Comparison], system: System, criterion: Criterion) -> str:
    """Plain CSV under COLUMNS, by wavelength, field, centre and half width; floats that read back exactly.

    ``field`` is in deg, or in mm at finite conjugates; ``deviation`` in standard errors.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    unit = DEG if system.telescope.object_at_infinity else 1.0
    for c in comparisons:
        place = [converted(c.wavelength, NM), converted(c.field.radius, unit), converted(c.field.azimuth, DEG)]
        columns = [c.convolution, c.estimate.energy, c.difference, c.standard_error, c.deviation]
        words = criterion.verdicts(c)
        for k, centre in enumerate(CENTRES):
            for i, half_width in enumerate(c.half_width):
                widths = [converted(half_width, UM), converted(2.0 * half_width / system.detector.pixel)]
                numbers = [*widths, *(float(column[k, i]) for column in columns)]
                writer.writerow([*map(repr, place), centre, *map(repr, numbers), words[k, i]])
    return stream.getvalue()


def name(comparison: Comparison, system: System) -> str:
    """Which image it is: wavelength and field."""
    field, at_infinity = comparison.field, system.telescope.object_at_infinity
    place = field_name(field.radius, field.azimuth, at_infinity=at_infinity)
    return f"{NM * comparison.wavelength:.6g} nm, field {place}"


def text_table(comparison: Comparison, system: System, criterion: Criterion) -> str:
    """Boxes about the Gaussian image point, some of them where they are many, with the one that deviates most.

    Energies are fractions of all light, deviations in standard errors, half widths in um and in detector pixels.
    """
    return "\n".join(_lines(comparison, system, criterion))


def _lines(c: Comparison, system: System, criterion: Criterion) -> Iterator[str]:
    yield ("half width [um]   [pixels]  convolution  Monte Carlo  difference  std. error  deviation  verdict")
    words = criterion.verdicts(c)[0]
    even = np.geomspace(c.half_width[0], c.half_width[-1], _MOST_LINES)
    chosen = np.abs(np.log(c.half_width / even[:, None])).argmin(axis=1)
    worst = int(np.argmax(np.abs(c.deviation[0]) * c.judged))
    for i in sorted({*chosen.tolist(), worst}):
        width = c.half_width[i]
        yield (
            f"{UM * width:15.4f}  {width / system.detector.pixel:9.4g}  {c.convolution[0, i]:11.7f}  "
            f"{c.estimate.energy[0, i]:11.7f}  {c.difference[0, i]:10.1e}  {c.standard_error[0, i]:10.1e}  "
            f"{c.deviation[0, i]:9.2f}  {words[i]}"
        )
