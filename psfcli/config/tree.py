"""The marked tree: what a YAML text says, each value with the place where it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from psfcli.config.faults import quoted

if TYPE_CHECKING:
    from psfcli.config.faults import Place

Atom = str | int | float | bool | None


@dataclass(frozen=True, slots=True)
class Scalar:
    """A single value, as written (``text``, ``style``) and as YAML 1.2 reads it (``value``)."""

    place: Place
    text: str
    value: Atom
    style: str | None = None

    @property
    def shown(self) -> str:
        """The value for a message: words in quotes, numbers bare, always on one line and cut short."""
        return quoted(self.text) if isinstance(self.value, str) else quoted(self.text)[1:-1]


@dataclass(frozen=True, slots=True)
class Sequence:
    """A list."""

    place: Place
    items: tuple[Node, ...]
    flow: bool = True


@dataclass(frozen=True, slots=True)
class Entry:
    """A key's place and its value."""

    key: Place
    node: Node


@dataclass(frozen=True, slots=True)
class Mapping:
    """Keys and values; ``key`` is the place of the key that holds it (of itself, in a list)."""

    place: Place
    key: Place
    entries: dict[str, Entry]
    flow: bool = True


@dataclass(frozen=True, slots=True)
class Broken:
    """A value whose fault is already told."""

    place: Place


Node = Scalar | Sequence | Mapping | Broken

_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_REAL = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS: dict[str, Atom] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}


def atom(text: str) -> Atom:
    """What a plain scalar means in the core schema of YAML 1.2: `010` is 10, `1e-9` a number, `no` a word."""
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text) and len(text) < 400:  # longer ones overflow a float anyway
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if _REAL.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text
