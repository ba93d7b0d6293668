"""One table of ensquared energies from those of several runs: sorted as psfcli sorts them, no row twice.

Usage: python sweep_merge.py MERGED.csv PART.csv ...
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

KEY = ("wavelength_nm", "field", "azimuth_deg", "half_width_um")


def merged(parts: list[Path]) -> list[list[str]]:
    """The header and the rows of all parts, sorted by KEY; numbers keep the digits they were written with.

    Raises ValueError when a part is no such table, or two parts disagree about the same box.
    """
    header: list[str] = []
    rows: dict[tuple[float, ...], list[str]] = {}
    for part in parts:
        with part.open(newline="", encoding="utf-8") as stream:
            reader = csv.reader(stream)
            names = next(reader, [])
            if not set(KEY) <= set(names) or (header and names != header):
                raise ValueError(f"{part}: is not a table of ensquared energies like the others")
            header = names
            columns = [names.index(name) for name in KEY]
            for row in reader:
                key = tuple(float(row[column]) for column in columns)
                if rows.setdefault(key, row) != row:
                    raise ValueError(f"{part}: line {reader.line_num} differs from the same box of another table")
    return [header, *(rows[key] for key in sorted(rows))]


def main(target: Path, parts: list[Path]) -> None:
    """Write the merged table; a kill leaves the old one or the new one, whole."""
    temporary = target.with_name(target.name + ".new")
    with temporary.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows(merged(parts))
    temporary.replace(target)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    try:
        main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
    except (OSError, ValueError) as fault:
        sys.exit(str(fault))
