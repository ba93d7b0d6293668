"""A fit as a table: every measured point beside what was fitted to it."""

from __future__ import annotations

import csv
import io

import numpy as np

from psfcli.metrology.fit import Fit
from psfcli.metrology.measurement import TWO_DIMENSIONAL
from psfcli.products.units import NM, converted

COLUMNS = ("instrument", "kind", "frequency_per_mm", "psd_unit", "psd", "fit", "gain", "log_residual", "scatter")


def csv_text(fit: Fit) -> str:
    """Plain CSV under COLUMNS, one row per point, floats with the digits that give them back.

    ``psd`` as measured and ``fit``, the spectrum of the surface, are in ``psd_unit`` and of the file's kind;
    ``log_residual`` is ln(psd/(gain fit)) less the bias of the logarithm, which ``scatter`` times a normal deviate is.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for one in fit.instruments:
        m = one.measurement
        power = 4 if m.kind == TWO_DIMENSIONAL else 3
        gain = float(np.exp(one.log_gain))
        points = zip(m.frequency, m.density, np.exp(one.log_fit).tolist(), one.log_residuals.tolist(), strict=True)
        for f, density, fitted, residual in points:
            values = (converted(value, NM**power) for value in (density, fitted))
            writer.writerow([m.name, m.kind, f, f"nm{power}", *values, gain, residual, one.scatter])
    return stream.getvalue()
