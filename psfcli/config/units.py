"""Values with units: the number in the units used inside (mm, rad, cycles/mm) of a text such as ``9.4 nm``.

The usual spellings are read here; astropy, which takes longer to load than a whole check, decides all others.
"""

from __future__ import annotations

import difflib
import math
import re
import warnings
from dataclasses import dataclass
from decimal import Decimal

from psfcli.config.faults import quoted

Factor = tuple[float, float]
"""(a, b): the value inside is number * a / b."""

_LENGTHS: dict[str, Factor] = {"pm": (1, 10**9), "Angstrom": (1, 10**7), "nm": (1, 10**6), "um": (1, 1000)}
_LENGTHS |= {"mm": (1, 1), "cm": (10, 1), "m": (1000, 1), "km": (10**6, 1)}
_ANGLES: dict[str, Factor] = {"rad": (1, 1), "mrad": (1, 1000), "deg": (math.pi, 180), "arcmin": (math.pi, 10800)}
_ANGLES |= {"arcsec": (math.pi, 648000), "mas": (math.pi, 648000000)}
# read by astropy as other things than the writer of a telescope file means
_MISTAKEN = {"u": ("an atomic mass", "um"), "A": ("an ampere", "Angstrom"), "Mm": ("a megametre", "mm")}

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
PATTERN = rf"^\s*{_NUMBER.pattern}\s*(?:1\s*/)?\s*[^\s0-9.].*$"
"""What a value with a unit looks like to an editor."""


@dataclass(frozen=True, slots=True)
class Dimension:
    """A physical dimension: its name, the unit used inside as astropy spells it, and its usual units."""

    name: str
    inside: str
    units: dict[str, Factor]


class Pixels(float):
    """A number of detector pixels, where a length may be given so."""


def _powers(n: int) -> dict[str, Factor]:
    return {f"{u}{mark}{n}": (a**n, b**n) for u, (a, b) in _LENGTHS.items() for mark in ("", "^", "**")}


LENGTH = Dimension("length", "mm", _LENGTHS)
ANGLE = Dimension("angle", "rad", _ANGLES)
FREQUENCY = Dimension("spatial frequency", "1/mm", {f"1/{u}": (b, a) for u, (a, b) in _LENGTHS.items()})
VOLUME = Dimension("length^3", "mm3", _powers(3))
LENGTH4 = Dimension("length^4", "mm4", _powers(4))
SHIFT = Dimension("length", "mm", _LENGTHS | {"pix": (1, 1), "pixel": (1, 1)})


def convert(text: str, dimension: Dimension, example: str) -> float:
    """The value of ``text`` in the unit used inside; Pixels when a SHIFT is given in pixels.

    Raises ValueError with what is wrong, the value and a suggestion, when ``text`` is not a finite number followed by
    a unit of that dimension; ``example`` is a unit to suggest.
    """
    text = text.strip()
    number = _NUMBER.match(text)
    if number is None:
        raise ValueError(f"{quoted(text)} is not a number with a unit; write for example 1 {example}")
    unit = text[number.end() :].strip()
    if not unit:
        raise ValueError(f"{text[:40]} has no unit; write for example {number[0][:30]} {example}")
    if dimension is FREQUENCY:
        # a cycle is no angle here, and a line pair is a cycle; "1/mm" alone is one per mm, its number being the 1
        unit = re.sub(r"^(1|cycles?|lp|)\s*/\s*", "1/", unit)
    up, down = dimension.units.get(unit) or _by_astropy(text, unit, dimension, example)
    if not math.isfinite(float(number[0])):
        raise ValueError(f"{quoted(text)} is too large for a number")
    # in decimals, so that 1.05 um is the float nearest to 0.00105 mm
    value = float(Decimal(number[0]) * Decimal(up) / Decimal(down)) if float(number[0]) else 0.0
    return Pixels(value) if dimension is SHIFT and unit in ("pix", "pixel") else value


def mistaken(text: str) -> str:
    """The hint for a unit that is valid but seldom meant, such as Mm: empty, or beginning with a semicolon."""
    unit = text[match.end() :].strip() if (match := _NUMBER.match(text.strip())) else ""
    return f"; {unit} is {_MISTAKEN[unit][0]}, did you mean {_MISTAKEN[unit][1]}?" if unit in _MISTAKEN else ""


def _by_astropy(text: str, unit: str, dimension: Dimension, example: str) -> Factor:
    """The factor of a unit that only astropy knows; raises ValueError as ``convert`` does."""
    import astropy.units as u

    if len(unit) > 40:
        raise ValueError(f"{quoted(text)}: {quoted(unit)} is not a unit")
    if "," in unit:  # astropy would read a list of units
        raise ValueError(f"{quoted(text)} has a comma; write one number, with a point for decimals, and its unit")
    if re.search(r"(^|\s)[0-9.]", unit.removeprefix("1/")):
        raise ValueError(f"{quoted(text)} has a second number; write one number and its unit")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecated spellings
            parsed = u.Unit(unit)
    except (ValueError, TypeError, ArithmeticError):
        raise ValueError(
            f"{quoted(text)}: {quoted(unit)} is not a unit{_suggestion(unit, dimension, example)}"
        ) from None
    try:
        factor = float(parsed.to(u.Unit(dimension.inside)))
    except (u.UnitsError, TypeError, ArithmeticError):
        kind = str(parsed.physical_type)
        measured = "something else" if kind == "unknown" else kind
        hint = mistaken(text) if dimension.units.keys() >= _LENGTHS.keys() else ""
        hint = hint or f"; use for example {example}"
        raise ValueError(f"{quoted(text)} is of dimension {measured}, not {dimension.name}{hint}") from None
    return factor, 1.0


def _suggestion(unit: str, dimension: Dimension, example: str) -> str:
    lowered = {name.lower(): name for name in reversed(dimension.units)}
    close = difflib.get_close_matches(unit.lower(), lowered, 1, cutoff=0.5)
    return f"; did you mean {lowered[close[0]]}?" if close else f"; use for example {example}"
