"""The checker: the table of keys held against a marked tree."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any

from psfcli.config.kinds import (
    ByConjugates,
    ByPrescription,
    Either,
    Kind,
    Listing,
    Number,
    Quantity,
    Section,
    Text,
    Variants,
    Word,
)
from psfcli.config.scalars import quantity, scalar
from psfcli.config.tree import Broken, Mapping, Node, Scalar, Sequence

if TYPE_CHECKING:
    from psfcli.config.faults import Faults, Steps


def check(root: Node, table: Section, faults: Faults) -> Any:
    """The values of a tree, converted to the units used inside, as plain dicts and lists.

    Defaults are filled in. A key whose value is bad is left out, a bad item of a list is None; each is in ``faults``.
    """
    return _Checker(root, faults).value(table, root, ())


class _Checker:
    def __init__(self, root: Node, faults: Faults) -> None:
        self.faults = faults
        self.has_prescription = isinstance(root, Mapping) and "prescription" in root.entries
        keys = _keys(root, "prescription" if self.has_prescription else "telescope")
        self.may_be_infinity = not keys.isdisjoint(("focal_length", "aperture_diameter"))
        self.may_be_finite = not keys.isdisjoint(("image_distance", "exit_pupil_radius", "object_distance"))

    def value(self, kind: Kind, node: Node, steps: Steps, instead: str = "") -> Any:
        """The checked value of a node, or None after telling its fault; ``instead``: what else a scalar may be."""
        match kind, node:
            case _, Broken():
                return None
            case ByPrescription(), _:
                return self.value(kind.given if self.has_prescription else kind.without, node, steps)
            case Either(), _:
                return self.either(kind, node, steps)
            case Section(), Mapping():
                return self.section(kind, node, steps)
            case Variants(), Mapping():
                return self.variants(kind, node, steps)
            case Listing(), Sequence():
                return self.listing(kind, node, steps)
            case (Section() | Variants() | Listing(), _) | (_, Mapping() | Sequence() | Scalar(value=None)):
                return self.wrong_shape(kind, node, steps)
        assert isinstance(node, Scalar)
        try:
            if isinstance(kind, ByConjugates):
                return self.conjugate(kind, node)
            assert isinstance(kind, Quantity | Number | Word | Text)
            return scalar(kind, node)
        except ValueError as problem:
            self.faults.add(node.place, steps, f"{problem}{instead}")
            return None

    def wrong_shape(self, kind: Kind, node: Node, steps: Steps) -> None:
        self.faults.add(node.place, steps, f"{_look(node)} where {_wanted(kind)} is wanted")

    def either(self, kind: Either, node: Node, steps: Steps) -> Any:
        if isinstance(node, Sequence):
            return self.value(kind.listing, node, steps) if kind.listing else self.wrong_shape(kind, node, steps)
        fitting = kind.mapping if isinstance(node, Mapping) else kind.scalar
        if fitting is None:
            return self.wrong_shape(kind, node, steps)
        if kind.word and isinstance(node, Scalar) and node.text in kind.word.words:
            return node.text
        value = self.value(fitting, node, steps, f", or {' or '.join(kind.word.words)}" if kind.word else "")
        return [value] if kind.listed else value

    def listing(self, kind: Listing, node: Sequence, steps: Steps) -> list[Any]:
        if not kind.shortest <= len(node.items) <= kind.longest:
            span = str(kind.shortest) if kind.shortest == kind.longest else f"{kind.shortest}..{kind.longest}"
            self.faults.add(node.place, steps, f"a list of {len(node.items)}; allowed: {span} values")
        return [self.value(kind.of, item, (*steps, i)) for i, item in enumerate(node.items[: kind.longest])]

    def variants(self, kind: Variants, node: Mapping, steps: Steps) -> dict[str, Any]:
        entry = node.entries.get(kind.by)
        chosen = next((name for key, name in kind.signs.items() if key in node.entries), kind.default)
        if entry is not None:
            word = self.value(Word(tuple(kind.sections)), entry.node, (*steps, kind.by))
            if word is None:  # whose keys these are is unknown, so nothing more can be said of them
                return {}
            chosen = word
        own = kind.sections[chosen]
        owners = {k: [name for name, section in kind.sections.items() if k in section.keys] for k in node.entries}
        foreign = [key for key in node.entries if owners[key] and chosen not in owners[key]]
        for key in foreign:
            problem = f"a key of {kind.by} {', '.join(owners[key])}; {kind.by} {chosen} takes {', '.join(own.keys)}"
            self.faults.add(node.entries[key].key, (*steps, key), problem)
        return self.section(own, node, steps, frozenset(foreign))

    def section(
        self, kind: Section, node: Mapping, steps: Steps, foreign: frozenset[str] = frozenset()
    ) -> dict[str, Any]:
        """The values of a mapping; ``foreign`` keys are told already, and leave open which keys are missing."""
        values: dict[str, Any] = {}
        meant = set(foreign)
        for key, entry in node.entries.items():
            if key in kind.keys:
                meant.add(key)
                value = self.value(kind.keys[key].kind, entry.node, (*steps, key))
                if value is not None:
                    values[key] = value
            elif key in kind.refused:
                self.faults.add(entry.key, (*steps, key), kind.refused[key])
            elif key not in foreign:
                close = difflib.get_close_matches(key, [k for k in kind.keys if k not in node.entries], 1)
                close = close or difflib.get_close_matches(key, kind.keys, 1)
                meant.update(close)  # a misspelt key is one fault, not also a missing one
                advice = f"did you mean {close[0]}?" if close else f"allowed: {', '.join(kind.keys)}"
                self.faults.add(entry.key, (*steps, key), f"unknown key; {advice}")
        if not foreign:
            self.missing(kind, node, steps, meant)
        for key, spec in kind.keys.items():
            if key not in meant and spec.default is not None:
                default = Scalar(node.place, str(spec.default), spec.default)
                values[key] = self.value(spec.kind, default, (*steps, key))
        return values

    def missing(self, kind: Section, node: Mapping, steps: Steps, meant: set[str]) -> None:
        wanted = [key for key, spec in kind.keys.items() if spec.required]
        begun = [names for names in kind.alternatives if not meant.isdisjoint(names)]
        choice = ", ".join(" + ".join(names) for names in kind.alternatives)
        if len(begun) == 1:
            wanted += begun[0]
        elif kind.alternatives:
            given = [key for names in begun for key in names if key in node.entries]
            place = max([node.key, *(node.entries[key].key for key in given if node.entries[key].key.option)])
            got = f"got {', '.join(given)}" if given else "got none"
            self.faults.add(place, steps, f"exactly one of {choice} is wanted, {got}")
        for key in wanted:
            if key not in meant:
                self.faults.add(node.key, (*steps, key), f"missing key ({kind.keys[key].says.rstrip('.')})")
        for key, spec in kind.keys.items():
            if key in node.entries and spec.needs and spec.needs not in meant:
                self.faults.add(node.entries[key].key, (*steps, key), f"means nothing without {spec.needs}")

    def conjugate(self, kind: ByConjugates, node: Scalar) -> float:
        """The value of a field coordinate; raises ValueError with what is wrong."""
        if self.may_be_finite and self.may_be_infinity:
            try:  # that both are given is told at the telescope; this value may be meant either way
                return quantity(kind.infinity, node)
            except ValueError:
                return quantity(kind.finite, node)
        return quantity(kind.finite if self.may_be_finite else kind.infinity, node)


def _keys(root: Node, name: str) -> frozenset[str]:
    """The keys of the mapping at a key of the top, if there is one."""
    entry = root.entries.get(name) if isinstance(root, Mapping) else None
    return frozenset(entry.node.entries) if entry and isinstance(entry.node, Mapping) else frozenset()


def _look(node: Node) -> str:
    match node:
        case Sequence():
            return "a list"
        case Mapping():
            return "a mapping"
        case Scalar(value=None):
            return "nothing"
    assert isinstance(node, Scalar)
    return node.shown


def _wanted(kind: Kind) -> str:
    match kind:
        case Section() | Variants():
            return "a mapping of keys"
        case Listing():
            return "a list"
        case Either():
            shapes = [shape for shape in (kind.scalar, kind.word, kind.mapping, kind.listing) if shape]
            return " or ".join(dict.fromkeys(_wanted(shape) for shape in shapes))
        case ByPrescription():
            return _wanted(kind.given)
        case Quantity() | ByConjugates():
            return "a number with a unit"
        case Number():
            return "a number"
        case Word():
            return f"one of {', '.join(kind.words)}"
    return "a line of text"
