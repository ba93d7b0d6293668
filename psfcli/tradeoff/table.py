"""The tradeoff as a table: cells for readers, CSV for programs."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import TextIO

from psfcli.tolerance import Tolerance
from psfcli.tradeoff.ladder import OURS
from psfcli.tradeoff.measurement import Measurement

COLUMNS = (
    "method",
    "setting",
    "asked_pixel",
    "asked_ee",
    "estimated_pixel",
    "estimated_ee",
    "pixel_error",
    "ee_error",
    "seconds",
    "peak_memory_mb",
    "extrapolated",
)
HEADINGS = (
    "method",
    "setting",
    "pixel asked",
    "estimated",
    "true",
    "ee asked",
    "estimated",
    "true",
    "time [s]",
    "/ standard",
    "memory [MB]",
)


def cells(measurements: Sequence[Measurement]) -> list[list[str]]:
    """The rows of the table for readers, under HEADINGS, to two digits.

    What a method has not, and what could not be judged, is a dash.
    """
    standard = next(m.seconds for m in measurements if (m.method, m.setting) == (OURS, "standard"))
    return [
        [
            m.method,
            m.setting + (" (extrapolated)" if m.extrapolated else ""),
            *(_error(getattr(errors, name, math.nan)) for name in ("pixel", "ee") for errors in _three(m)),
            f"{m.seconds:.2g}" if m.seconds < 10.0 else f"{m.seconds:.0f}",
            f"{m.seconds / standard:.2g}" if m.seconds < 10.0 * standard else f"{m.seconds / standard:.0f}",
            f"{m.peak_memory:.0f}",
        ]
        for m in measurements
    ]


def text_table(measurements: Sequence[Measurement]) -> str:
    """The table in columns: names to the left, numbers to the right."""
    rows = [list(HEADINGS), *cells(measurements)]
    width = [max(len(row[i]) for row in rows) for i in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(cell.ljust(w) if i < 2 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, width, strict=True)))
        for row in rows
    )


def csv_text(measurements: Iterable[Measurement]) -> str:
    """Plain CSV under COLUMNS: floats with the digits that give them back, nothing for what there is not."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for m in measurements:
        errors = [getattr(errors, name, math.nan) for errors in _three(m) for name in ("pixel", "ee")]
        numbers = [*errors, m.seconds, m.peak_memory]
        shown = ["" if math.isnan(number) else repr(float(number)) for number in numbers]
        writer.writerow([m.method, m.setting, *shown, int(m.extrapolated)])
    return stream.getvalue()


def read_csv(stream: TextIO) -> list[Measurement]:
    """The measurements that ``csv_text`` wrote."""
    found = []
    for row in csv.DictReader(stream):
        number = {name: float(row[name] or "nan") for name in COLUMNS[2:]}
        asked, estimated, true = (
            Tolerance(number[a], number[b])
            for a, b in (("asked_pixel", "asked_ee"), ("estimated_pixel", "estimated_ee"), ("pixel_error", "ee_error"))
        )
        found.append(
            Measurement(
                row["method"],
                row["setting"],
                true,
                number["seconds"],
                number["peak_memory_mb"],
                asked if row["asked_pixel"] else None,
                estimated if row["estimated_pixel"] else None,
                extrapolated=bool(number["extrapolated"]),
            )
        )
    return found


def _three(m: Measurement) -> tuple[Tolerance | None, Tolerance | None, Tolerance]:
    return m.asked, m.estimated, m.true


def _error(error: float) -> str:
    if math.isnan(error):
        return "-"
    return f"{error:.1e}" if error else "0"
