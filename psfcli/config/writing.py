"""A marked tree written out as YAML: the effective system file after options."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from psfcli.config.tree import Broken, Mapping, Node, Scalar, Sequence

if TYPE_CHECKING:
    from collections.abc import Iterator


def written(root: Node) -> str:
    """The YAML text of a tree, each scalar spelt as it was read; it loads back to the same values."""
    events = [yaml.StreamStartEvent(), yaml.DocumentStartEvent(explicit=False), *_events(root)]
    events += [yaml.DocumentEndEvent(explicit=False), yaml.StreamEndEvent()]
    return str(yaml.emit(events, width=10**9, allow_unicode=True))


def _events(node: Node) -> Iterator[yaml.Event]:
    assert not isinstance(node, Broken)
    if isinstance(node, Scalar):
        yield yaml.ScalarEvent(None, None, (True, True), node.text, style=node.style)
    elif isinstance(node, Sequence):
        yield yaml.SequenceStartEvent(None, None, True, flow_style=node.flow)
        for item in node.items:
            yield from _events(item)
        yield yaml.SequenceEndEvent()
    elif isinstance(node, Mapping):
        yield yaml.MappingStartEvent(None, None, True, flow_style=node.flow)
        for key, entry in node.entries.items():
            yield yaml.ScalarEvent(None, None, (True, True), key)
            yield from _events(entry.node)
        yield yaml.MappingEndEvent()
