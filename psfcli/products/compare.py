"""Whether two products agree: directories, FITS files or tables of ensquared energy."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.differences import Difference, ensquared_difference
from psfcli.products.tables import EE_COLUMNS, read_csv
from psfcli.products.target import EE_TABLE, FITS, MANIFEST
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class ComparisonError(Exception):
    """The two cannot be compared: unreadable, of different shape, or of unknown accuracy; one line that says why."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What ``compare`` found, HDU by HDU and column by column, and the ``tolerance`` it was held against."""

    differences: tuple[Difference, ...]
    tolerance: Tolerance

    @property
    def within(self) -> bool:
        """Whether no value differs by more than is allowed."""
        return not any(d.beyond for d in self.differences)


def compare(a: Path, b: Path, tolerance: Tolerance | None = None) -> Comparison:
    """How two products differ: two directories (what both hold of psf.fits and ee.csv), FITS files, or CSV files.

    ``tolerance`` None: the sum of the accuracies the two were asked for, which psf.fits says, or for a CSV file
    the manifest or the psf.fits beside it. Allowed are, with P the larger of two values,

    - PSF, PSF_OVER: ``pixel`` P, and ``ee`` more in pixels that unscattered light touches (FIELDS tells which)
      and their neighbours; below 1e-30 of the light anything;
    - ensquared energies: ``ee``; power in and outside the frame: ``pixel`` P + ``ee``;
    - lengths in FIELDS: 1e-9 P and a picometre; all other numbers: 1e-9 P.

    Text must be equal. Versions, title, system file, asked and estimated accuracies and the validity of the model are
    not compared. Raises ComparisonError.
    """
    pairs = _pairs(a, b)
    if tolerance is None:
        asked = [_asked(path) for path in (a, b)]
        tolerance = Tolerance(sum(t.pixel for t in asked), sum(t.ee for t in asked))
    found: list[Difference] = []
    for first, second in pairs:
        try:
            found += _differences(first, second, tolerance)
        except (OSError, ValueError, KeyError, TypeError, IndexError, csv.Error, Warning) as fault:
            reason = " ".join(str(fault).split()) or type(fault).__name__
            raise ComparisonError(f"{first} and {second}: cannot be compared: {reason}") from fault
    return Comparison(tuple(found), tolerance)


def _pairs(a: Path, b: Path) -> list[tuple[Path, Path]]:
    for path in (a, b):
        if not path.exists():
            raise ComparisonError(f"{path}: does not exist")
    if a.is_dir() != b.is_dir():
        raise ComparisonError(f"{a} and {b}: one is a directory, the other a file")
    if not a.is_dir():
        if (a.suffix == ".csv") != (b.suffix == ".csv"):
            raise ComparisonError(f"{a} and {b}: one is CSV, the other is not")
        return [(a, b)]
    pairs = [(a / name, b / name) for name in (FITS, EE_TABLE) if (a / name).is_file() and (b / name).is_file()]
    if not pairs:
        raise ComparisonError(f"{a} and {b}: have neither {FITS} nor {EE_TABLE} in common")
    return pairs


def _differences(a: Path, b: Path, tolerance: Tolerance) -> list[Difference]:
    if a.suffix == ".csv":
        return _table_differences(read_csv(a), read_csv(b), tolerance)
    from psfcli.products.compare_fits import fits_differences  # loads astropy.io.fits, which tables do without

    return fits_differences(a, b, tolerance)


def _asked(path: Path) -> Tolerance:
    """The accuracy a product was asked for."""
    directory = path if path.is_dir() else path.parent
    manifest = directory / MANIFEST
    try:
        if path.is_file() and path.suffix != ".csv":
            return _asked_in_fits(path)
        if manifest.is_file():
            accuracy = json.loads(manifest.read_text(encoding="utf-8"))["accuracy"]
            return Tolerance(float(accuracy["pixel"]), float(accuracy["ee"]))
        return _asked_in_fits(directory / FITS)
    except (OSError, ValueError, KeyError, TypeError) as fault:
        raise ComparisonError(
            f"{path}: nothing readable says which accuracy it was asked for; give --pixel-error and --ee-error"
        ) from fault


def _asked_in_fits(path: Path) -> Tolerance:
    from psfcli.products.compare_fits import asked_accuracy

    return asked_accuracy(path)


def _table_differences(a: NDArray[np.float64], b: NDArray[np.float64], tolerance: Tolerance) -> list[Difference]:
    if a.shape != b.shape:
        raise ValueError(f"{len(a)} against {len(b)} rows")
    return [
        ensquared_difference(f"{EE_TABLE} {name}", name, a[:, column], b[:, column], tolerance)
        for column, name in enumerate(EE_COLUMNS)
    ]
