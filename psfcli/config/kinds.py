"""The kinds of values a system file holds: what the table of keys is written in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from psfcli.config.units import Dimension


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with a unit between ``low`` and ``high``; ``unit`` is the one to suggest.

    ``magnitude``: the range holds for the value without its sign. ``why``: the reason for the range.
    """

    dimension: Dimension
    low: str
    high: str
    unit: str
    magnitude: bool = False
    why: str = ""


@dataclass(frozen=True, slots=True)
class ByConjugates:
    """A field coordinate: an angle for an object at infinity, an object height at finite conjugates."""

    infinity: Quantity
    finite: Quantity


@dataclass(frozen=True, slots=True)
class ByPrescription:
    """A value that is of one kind where the telescope is given as third-order optics sees it, else of another."""

    without: Kind
    given: Kind


@dataclass(frozen=True, slots=True)
class Number:
    """A bare number; ``beyond``: greater than ``low``, not equal; ``below``: less than ``high``, not equal."""

    low: float
    high: float
    beyond: bool = False
    below: bool = False
    whole: bool = False


@dataclass(frozen=True, slots=True)
class Word:
    """One of some words."""

    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text."""


@dataclass(frozen=True, slots=True)
class Listing:
    """A list of ``shortest`` to ``longest`` values of one kind."""

    of: Kind
    shortest: int
    longest: int


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a section: its value's kind, a sentence for the reference, and when it may be left out.

    ``default`` is written as in the file; ``needs`` names a key without which this one means nothing.
    """

    kind: Kind
    says: str
    required: bool = False
    default: str | int | None = None
    needs: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A mapping; of ``alternatives``, sets of keys, exactly one must be there in full.

    ``refused``: keys that users may well expect here, and why there are none.
    """

    keys: dict[str, Key]
    alternatives: tuple[tuple[str, ...], ...] = ()
    name: str = ""
    refused: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Variants:
    """A mapping whose section is chosen by the word under the key ``by``, or by a key that is a sign of it alone."""

    by: str
    default: str
    sections: dict[str, Section]
    signs: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Either:
    """A scalar, a mapping or a list, told apart by looks; ``listed``: a lone value counts as a list of one.

    ``word`` may stand in place of the scalar.
    """

    scalar: Quantity | ByConjugates | Word | None = None
    word: Word | None = None
    mapping: Section | Variants | None = None
    listing: Listing | None = None
    listed: bool = False


Kind = Quantity | ByConjugates | ByPrescription | Number | Word | Text | Listing | Section | Variants | Either
