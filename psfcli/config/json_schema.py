"""The JSON Schema of a system file, for editors."""

from __future__ import annotations

from typing import Any

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
from psfcli.config.table import SYSTEM
from psfcli.config.units import PATTERN


def schema() -> dict[str, Any]:
    """The structure of a system file as JSON Schema (draft 2020-12); ranges of values with units are not in it."""
    top = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "psfcli system file"}
    return top | _schema(SYSTEM)


def _schema(kind: Kind) -> dict[str, Any]:
    match kind:
        case Quantity():
            return {"type": "string", "pattern": PATTERN, "description": f"{kind.low}..{kind.high}"}
        case ByConjugates():
            return {"type": "string", "pattern": PATTERN}
        case ByPrescription():
            return {}  # what it is stands beside the properties, for it depends on another of them
        case Number():
            low = "exclusiveMinimum" if kind.beyond else "minimum"
            high = "exclusiveMaximum" if kind.below else "maximum"
            return {"type": "integer" if kind.whole else "number", low: kind.low, high: kind.high}
        case Word():
            return {"enum": list(kind.words)}
        case Listing():
            return {
                "type": "array",
                "items": _schema(kind.of),
                "minItems": kind.shortest,
                "maxItems": kind.longest,
            }
        case Section():
            return _section(kind)
        case Variants():
            return {"oneOf": [_variant(kind, name) for name in kind.sections]}
        case Either():
            shapes = [shape for shape in (kind.scalar, kind.word, kind.mapping, kind.listing) if shape]
            return {"anyOf": [_schema(shape) for shape in shapes]}
    return {"type": "string"}


def _section(kind: Section) -> dict[str, Any]:
    made: dict[str, Any] = {
        "type": "object",
        "properties": {name: _key(key) for name, key in kind.keys.items()},
        "required": [name for name, key in kind.keys.items() if key.required],
        "additionalProperties": False,
    }
    either = {name: key.kind for name, key in kind.keys.items() if isinstance(key.kind, ByPrescription)}
    if either:
        made["if"] = {"required": ["prescription"]}
        made["then"] = {"properties": {name: _schema(one.given) for name, one in either.items()}}
        made["else"] = {"properties": {name: _schema(one.without) for name, one in either.items()}}
    needs = {name: [key.needs] for name, key in kind.keys.items() if key.needs}
    if needs:
        made["dependentRequired"] = needs
    if kind.alternatives:
        every = {name for names in kind.alternatives for name in names}
        made["oneOf"] = [
            {
                "required": list(names),
                "not": {"anyOf": [{"required": [other]} for other in sorted(every.difference(names))]},
            }
            for names in kind.alternatives
        ]
    return made


def _variant(kind: Variants, name: str) -> dict[str, Any]:
    made = _section(kind.sections[name])
    made["properties"][kind.by] = {"const": name}
    if name != kind.default and name not in kind.signs.values():
        made["required"].append(kind.by)
    return made


def _key(key: Key) -> dict[str, Any]:
    made = _schema(key.kind)
    says = " ".join(filter(None, (key.says, made.get("description"))))
    return made | {"description": says} | ({} if key.default is None else {"default": key.default})
