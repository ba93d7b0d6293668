"""Files of measured spectra: text with two columns, frequency and power spectral density, and a header with units."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from psfcli.config.faults import ConfigError, quoted
from psfcli.config.source import read
from psfcli.config.units import FREQUENCY, LENGTH4, VOLUME, convert
from psfcli.metrology.measurement import KINDS, ONE_SIDED, TWO_DIMENSIONAL, TWO_SIDED, Measurement

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

Line = tuple[int, str]

_COMMENT = "#%!"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_GAPS = {"", "-", "nan", "na", "n/a", "null", "none"}
_ENTRY = re.compile(r"(kind|frequency[ _-]unit|psd[ _-]unit|instrument)\s*[:=,;\t]\s*(.*)", re.IGNORECASE)
_UNIT = re.compile(r"\[([^\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")
_SPELT = {
    ONE_SIDED: re.compile(r"\b1[- ]?d[- ,]*one[- ]?sided\b|\bone[- ]?sided[- ,]*1[- ]?d\b"),
    TWO_SIDED: re.compile(r"\b1[- ]?d[- ,]*two[- ]?sided\b|\btwo[- ]?sided[- ,]*1[- ]?d\b"),
    TWO_DIMENSIONAL: re.compile(r"\b2[- ]?d\b|\btwo[- ]dimensional\b"),
}
_BAND = 1e-9, 1e9  # cycles/mm, as of sigma_band
_MOST_FAULTS = 8  # of one file
_MISSING = {
    "kind": "does not say which kind of spectrum it holds; begin it with '# kind: KIND' or say --kind KIND (beside "
    f"files: in a system file, kind: KIND), KIND being '{ONE_SIDED}' (its integral over f > 0 is the variance), "
    f"'{TWO_SIDED}' (half as large) or '{TWO_DIMENSIONAL}' (mean over directions in the plane)",
    "frequency_unit": "states no frequency unit; head its columns 'frequency [1/mm], psd [nm2 mm2]', begin it with "
    "'# frequency unit: 1/mm', or say --frequency-unit 1/mm (beside files: in a system file, frequency_unit: 1/mm)",
    "psd_unit": "states no psd unit; head its columns 'frequency [1/mm], psd [nm2 mm2]', begin it with "
    "'# psd unit: nm2 mm2', or say --psd-unit 'nm2 mm2' (beside files: in a system file, psd_unit: nm2 mm2)",
}


@dataclass(frozen=True, slots=True)
class Stated:
    """What is stated of a spectrum apart from its numbers: one of KINDS, and units as written; empty: not stated."""

    kind: str = ""
    frequency_unit: str = ""
    psd_unit: str = ""


def read_spectra(sources: Sequence[str | Path], otherwise: Stated | None = None) -> list[Measurement]:
    """The spectra of several files, each of an instrument of its own. Raises ConfigError with the faults of all."""
    found: list[Measurement] = []
    faults: list[str] = []
    for i, source in enumerate(sources):
        if source in sources[:i]:
            faults.append(f"{source}: given twice; each file is one measurement")
            continue
        try:
            found.append(read_spectrum(source, otherwise))
        except ConfigError as error:
            faults += error.faults
    names = [one.name for one in found]
    for name in sorted({name for name in names if names.count(name) > 1}):
        faults.append(f"{names.count(name)} files are of instrument {quoted(name)}; name each: # instrument: NAME")
    if faults:
        raise ConfigError(faults)
    return found


def read_spectrum(source: str | Path, otherwise: Stated | None = None) -> Measurement:
    """The spectrum in a file, rising in frequency, in cycles/mm and mm^3 (1-D) or mm^4 (2-D).

    Kind and units stand in the file; ``otherwise`` holds where it does not say. Left out are the row
    at f = 0 (the mean), of a two-sided spectrum the rows below it (the mirrored half), gaps (nan, or nothing) and rows
    that repeat another. Raises ConfigError with every fault.
    """
    name, text = read(source, "a file of a spectrum")
    if "\0" in text:
        raise ConfigError([f"{name}: not text; a file of a spectrum has two columns of numbers, frequency and psd"])
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    comments = [(number, line.lstrip(_COMMENT + " \t")) for number, line in lines if line[0] in _COMMENT]
    rows = [(number, line) for number, line in lines if line[0] not in _COMMENT]
    heads = next((i for i, (_, line) in enumerate(rows) if _NUMBER.match(_cells(line)[0])), len(rows))
    if heads == len(rows):
        raise ConfigError([f"{name}: no numbers; a file of a spectrum has two columns, frequency and psd"])
    faults: list[str] = []
    instrument, said = _header(comments, rows[:heads], name)
    stated = _joined(said, otherwise or Stated(), name, faults)
    f_scale, scale = _scales(stated, name, faults)
    points = _points(rows[heads:], stated.kind, name, faults)
    if faults:
        raise ConfigError(faults[:_MOST_FAULTS])
    found = sorted({(f * f_scale, density * scale) for f, density in points})
    if not found:
        raise ConfigError([f"{name}: no point above f = 0"])
    frequency, density = zip(*found, strict=True)
    if not _BAND[0] <= frequency[0] <= frequency[-1] <= _BAND[1]:
        band = f"{frequency[0]:.3g}..{frequency[-1]:.3g} cycles/mm"
        raise ConfigError([f"{name}: {band} is no band of a surface; is {stated.frequency_unit} the unit?"])
    if not (min(density) > 0.0 and max(density) < math.inf):
        raise ConfigError([f"{name}: densities beyond all numbers; is {stated.psd_unit} the unit?"])
    return Measurement(instrument or Path(name).stem, stated.kind, frequency, density)


def _cells(line: str) -> list[str]:
    """The cells of a line, whichever of semicolon, tab, comma and blank separates them; nothing after the last."""
    mark = next((mark for mark in ";\t," if mark in line), None)
    cells = [cell.strip().strip("\"'") for cell in (line.split(mark) if mark else line.split())]
    return cells[:2] if len(cells) > 2 and not any(cells[2:]) else cells


def _header(comments: Iterable[Line], heads: Iterable[Line], name: str) -> tuple[str, Stated]:
    """The instrument and what is stated by lines `key: value`, or else by the heads of the columns."""
    said: dict[str, str] = {}
    in_heads: dict[str, str] = {}
    for number, line in [*comments, *heads]:
        entry = _ENTRY.fullmatch(line.rstrip(",;\t ").strip("\"'"))
        units = [square or round_ for square, round_ in _UNIT.findall(line)]
        if entry:
            key, value = re.sub("[ -]", "_", entry[1].lower()), entry[2].strip().strip("\"'")
            said[key] = _kind(value) if key == "kind" else value
            if not said[key]:
                raise ConfigError([f"{name}:{number}: {key} {quoted(value)} is unknown; allowed: {', '.join(KINDS)}"])
        elif len(units) == 2 and len(_cells(line)) == 2:
            in_heads |= {"frequency_unit": units[0].strip(), "psd_unit": units[1].strip(), "kind": _kind(line)}
    instrument = said.pop("instrument", "")
    return instrument if instrument.isprintable() else "", Stated(**(in_heads | said))


def _kind(text: str) -> str:
    """The one of KINDS that a text names, in one of the usual spellings; empty where it names none, or several."""
    plain = text.lower().replace("_", " ")
    named = [kind for kind, spelt in _SPELT.items() if spelt.search(plain)]
    return named[0] if len(named) == 1 else ""


def _joined(said: Stated, otherwise: Stated, name: str, faults: list[str]) -> Stated:
    """What the file states, and else what is said of it; told is what is missing."""
    joined = {}
    for field in (field.name for field in fields(Stated)):
        own, other = getattr(said, field), getattr(otherwise, field)
        joined[field] = own or other
        if not joined[field]:
            faults.append(f"{name}: {_MISSING[field]}")
    return Stated(**joined)


def _scales(stated: Stated, name: str, faults: list[str]) -> tuple[float, float]:
    """What a frequency and a density are multiplied by to be in cycles/mm and in mm^3 or mm^4."""
    dimension, example = (LENGTH4, "nm2 mm2") if stated.kind == TWO_DIMENSIONAL else (VOLUME, "nm2 mm")
    found = []
    for what, unit, of, usual in (
        ("frequency unit", stated.frequency_unit, FREQUENCY, "1/mm"),
        (f"psd unit ({stated.kind})", stated.psd_unit if stated.kind else "", dimension, example),
    ):
        try:
            found.append(convert(f"1 {unit}", of, usual) if unit else math.nan)
        except ValueError as problem:
            faults.append(f"{name}: {what}: {problem}")
            found.append(math.nan)
    return found[0], found[1]


def _points(rows: Iterable[Line], kind: str, name: str, faults: list[str]) -> list[tuple[float, float]]:
    """The frequencies and densities of the rows that hold some above f = 0, as written."""
    found = []
    for number, line in rows:
        cells = _cells(line)
        try:
            point = _point(cells, kind)
        except ValueError as problem:
            decimal = len(cells) > 2 or any("," in cell for cell in cells)
            faults.append(f"{name}:{number}: {problem}{'; decimal commas are not read, write points' * decimal}")
            continue
        if point:
            found.append(point)
    return found


def _point(cells: Sequence[str], kind: str) -> tuple[float, float] | None:
    """The frequency and the density of a row, or None for one that is left out; raises ValueError otherwise."""
    if len(cells) != 2:
        raise ValueError(f"{len(cells)} value{'s' * (len(cells) > 1)} where frequency and psd are wanted")
    if any(cell.lower() in _GAPS for cell in cells):
        return None
    wrong = [cell for cell in cells if not _NUMBER.fullmatch(cell) or math.isinf(float(cell))]
    if wrong:
        raise ValueError(f"{quoted(wrong[0])} is no finite number")
    f, density = map(float, cells)
    if f == 0.0 or (f < 0.0 and kind == TWO_SIDED):
        return None
    if f < 0.0:
        raise ValueError(f"frequency {cells[0]} is below 0, where only a {TWO_SIDED} spectrum goes on")
    if density <= 0.0:
        raise ValueError(f"psd {cells[1]} is not above 0; leave the point out (nan) where noise was subtracted")
    return f, density
