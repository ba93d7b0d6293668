"""Growing a marked tree from YAML text.

It is built from the parser's events, which carry positions and let nesting and aliases be bounded while they are read.
"""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, cast

import yaml

from psfcli.config.faults import quoted
from psfcli.config.source import line_and_column
from psfcli.config.tree import Broken, Entry, Mapping, Node, Scalar, Sequence, atom

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from psfcli.config.faults import Faults, Place, Steps

DEEPEST = 20
"""Levels of nesting; a system file needs six."""
MOST_NODES = 200_000
"""Values after aliases are expanded; ten thousand fields, each with its azimuth, make 50 001."""


def grow(text: str, locate: Callable[[int, int], Place], faults: Faults, steps: Steps = ()) -> Node:
    """The tree of a YAML text whose top stands at ``steps``; ``locate`` makes a Place of a 1-based line and column.

    What is wrong with the YAML itself goes to ``faults``, and Broken takes the place of the value.
    """
    try:
        loader = yaml.SafeLoader(text)
        return _Grower(loader, locate, faults).document(steps)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = locate(mark.line + 1, mark.column + 1) if mark else locate(1, 1)
        problem = _problem(error)
    except yaml.reader.ReaderError as error:
        place = locate(*line_and_column(text, error.position))
        problem = f"character U+{ord(text[error.position]):04X} is not allowed in YAML"
    except (ValueError, OverflowError):  # an escape such as "\UFFFFFFFF" leaks as one of these
        mark = loader.get_mark()
        place, problem = locate(mark.line + 1, mark.column + 1), "not valid YAML: this character does not exist"
    faults.add(place, (), problem)
    return Broken(place)


class _Refused(yaml.MarkedYAMLError):
    """YAML that is valid, and yet no system file."""

    def __init__(self, event: yaml.Event, problem: str) -> None:
        super().__init__(problem=problem, problem_mark=cast("yaml.Mark", event.start_mark))


def _problem(error: yaml.MarkedYAMLError) -> str:
    if isinstance(error, _Refused):
        return str(error.problem)
    if "'\\t'" in (error.problem or ""):
        return "a tab; YAML is indented and separated by spaces"
    began = f" (in what begins at line {error.context_mark.line + 1})" if error.context_mark else ""
    return f"not valid YAML: {error.problem}{began}"


class _Grower:
    def __init__(self, loader: yaml.SafeLoader, locate: Callable[[int, int], Place], faults: Faults) -> None:
        self.loader = loader
        self.locate = locate
        self.faults = faults
        self.anchors: dict[str, tuple[Node, int]] = {}
        self.nodes = 0

    def document(self, steps: Steps) -> Node:
        self.event()
        if isinstance(self.event(), yaml.StreamEndEvent):
            return Scalar(self.locate(1, 1), "", None)
        node = self.node(self.event(), steps, None)
        self.event()
        after = self.event()
        if not isinstance(after, yaml.StreamEndEvent):
            raise _Refused(after, "a second document; one system per file")
        return node

    def event(self) -> yaml.Event:
        return cast("yaml.Event", self.loader.get_event())  # type: ignore[no-untyped-call]

    def place(self, event: yaml.Event) -> Place:
        mark = cast("yaml.Mark", event.start_mark)
        return self.locate(mark.line + 1, mark.column + 1)

    def node(self, event: yaml.Event, steps: Steps, key: Place | None) -> Node:
        place = self.place(event)
        if isinstance(event, yaml.AliasEvent):
            return self.alias(event)
        self.tally(event, 1)
        before = self.nodes
        node: Node
        if isinstance(event, yaml.ScalarEvent):
            value = atom(event.value) if event.style is None else event.value
            node = Scalar(place, event.value, value, event.style)
        elif len(steps) > DEEPEST:
            raise _Refused(event, f"nested deeper than {DEEPEST} levels")
        elif isinstance(event, yaml.SequenceStartEvent):
            node = Sequence(place, tuple(self.items(steps)), bool(event.flow_style))
        else:
            assert isinstance(event, yaml.MappingStartEvent)
            node = Mapping(place, key or place, self.entries(steps), bool(event.flow_style))
        if self.refuse_tag(event, place, steps):
            node = Broken(place)
        if event.anchor is not None:
            self.anchors[event.anchor] = node, self.nodes - before + 1
        return node

    def refuse_tag(self, event: yaml.ScalarEvent | yaml.CollectionStartEvent, place: Place, steps: Steps) -> bool:
        if event.tag is not None:
            tag = quoted(event.tag.replace("tag:yaml.org,2002:", "!!"))
            self.faults.add(place, steps, f"tag {tag} is not allowed; write the bare value")
        return event.tag is not None

    def alias(self, event: yaml.AliasEvent) -> Node:
        if event.anchor not in self.anchors:
            raise _Refused(event, f"alias *{event.anchor} stands before or within its anchor &{event.anchor}")
        node, size = self.anchors[event.anchor]
        self.tally(event, size)
        return node

    def tally(self, event: yaml.Event, more: int) -> None:
        self.nodes += more
        if self.nodes > MOST_NODES:
            raise _Refused(event, f"more than {MOST_NODES} values once aliases are expanded")

    def items(self, steps: Steps) -> Iterator[Node]:
        for index in count():
            event = self.event()
            if isinstance(event, yaml.SequenceEndEvent):
                return
            yield self.node(event, (*steps, index), None)

    def entries(self, steps: Steps) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        merged: list[Node] = []
        while not isinstance(event := self.event(), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise _Refused(event, "a key must be a single word")
            place = self.place(event)
            self.refuse_tag(event, place, (*steps, event.value))
            node = self.node(self.event(), (*steps, event.value), place)
            if event.value in entries:
                first = entries[event.value].key
                self.faults.add(place, (*steps, event.value), f"duplicate key; first given at line {first.line}")
            elif event.value == "<<" and event.style is None:
                merged += node.items if isinstance(node, Sequence) else [node]
            else:
                entries[event.value] = Entry(place, node)
        for node in merged:
            if isinstance(node, Mapping):
                entries = {**node.entries, **entries}
            elif not isinstance(node, Broken):
                self.faults.add(node.place, (*steps, "<<"), "only mappings can be merged")
        return entries
