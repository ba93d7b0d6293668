"""The reference of the system file, as Markdown."""

from __future__ import annotations

from psfcli.config.kinds import (
    ByConjugates,
    ByPrescription,
    Either,
    Key,
    Kind,
    Listing,
    Number,
    Quantity,
    Section,
    Variants,
    Word,
)
from psfcli.config.scalars import span
from psfcli.config.table import SYSTEM


def reference() -> str:
    """A table for each section of a system file: key, value, whether it may be left out, meaning."""
    return "\n".join(_table(section) for section in _sections(SYSTEM))


def _sections(kind: Kind | None) -> dict[Section, None]:
    """Every section in or below a kind, once, in the order of the file."""
    match kind:
        case Section():
            below = {inner: None for key in kind.keys.values() for inner in _sections(key.kind)}
            return {kind: None} | below
        case Variants():
            return {inner: None for section in kind.sections.values() for inner in _sections(section)}
        case Listing():
            return _sections(kind.of)
        case Either():
            return _sections(kind.mapping) | _sections(kind.listing)
        case ByPrescription():
            return _sections(kind.without) | _sections(kind.given)
    return {}


def _table(section: Section) -> str:
    lines = [f"### `{section.name}`", "", "| key | value | default | meaning |", "|---|---|---|---|"]
    lines += [f"| `{name}` | {_value(key.kind)} | {_default(key)} | {key.says} |" for name, key in section.keys.items()]
    if section.alternatives:
        sets = " or ".join(" and ".join(f"`{name}`" for name in names) for names in section.alternatives)
        lines += ["", f"Exactly one of: {sets}."]
    return "\n".join([*lines, ""])


def _default(key: Key) -> str:
    if key.required:
        return "required"
    return "" if key.default is None else f"`{key.default}`"


def _value(kind: Kind) -> str:
    match kind:
        case Quantity():
            size = "in magnitude " if kind.magnitude else ""
            return f"{kind.dimension.name}, {size}{kind.low} .. {kind.high}"
        case ByConjugates():
            return f"{_value(kind.infinity)}; at finite conjugates {_value(kind.finite)}"
        case ByPrescription():
            return f"{_value(kind.without)}; with a prescription {_value(kind.given)}"
        case Number():
            return f"{'whole number' if kind.whole else 'number'}, {span(kind)}"
        case Word():
            return " or ".join(f"`{word}`" for word in kind.words)
        case Listing():
            many = str(kind.shortest) if kind.shortest == kind.longest else f"{kind.shortest} to {kind.longest}"
            return f"list of {many}: {_value(kind.of)}"
        case Section():
            return f"`{kind.name}`"
        case Variants():
            return " or ".join(f"`{section.name}`" for section in kind.sections.values())
        case Either():
            shapes = [shape for shape in (kind.scalar, kind.word, kind.mapping, kind.listing) if shape]
            return "; or ".join(_value(shape) for shape in shapes)
    return "text"
