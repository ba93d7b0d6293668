"""Following a key path through a marked tree, and replacing what stands there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from psfcli.config.tree import Broken, Entry, Mapping, Node, Scalar, Sequence

if TYPE_CHECKING:
    from psfcli.config.faults import Place, Steps


def follow(node: Node, steps: Steps) -> tuple[Node, Steps]:
    """The node at ``steps`` and the steps that lead there; index 0 of what is no list is the thing itself.

    Where the path ends early, the last node met.
    """
    taken: Steps = ()
    for step in steps:
        if isinstance(node, Sequence) and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
        elif isinstance(node, Mapping) and step in node.entries:
            node = node.entries[str(step)].node
        elif step == 0 and not isinstance(node, Sequence):
            continue
        else:
            break
        taken = (*taken, step)
    return node, taken


def with_value(node: Node, steps: Steps, value: Node, key: Place) -> Node:
    """A tree with ``value`` at ``steps``; a key that is not there is added, its place being ``key``.

    Raises ValueError, saying why, where the path cannot lead.
    """
    if not steps:
        return value
    if isinstance(node, Broken):
        return node
    step, rest = steps[0], steps[1:]
    if isinstance(node, Sequence):
        if not isinstance(step, int) or step >= len(node.items):
            allowed = f"0..{len(node.items) - 1}" if node.items else "none, the list is empty"
            raise ValueError(f"{step} is no index of this list; allowed: {allowed}")
        changed = with_value(node.items[step], rest, value, key)
        return replace(node, items=(*node.items[:step], changed, *node.items[step + 1 :]))
    if step == 0:  # a lone value stands for a list of one
        return with_value(node, rest, value, key)
    if isinstance(node, Scalar):
        raise ValueError(f"there is no {step} in the single value {node.shown}")
    old = node.entries.get(str(step), Entry(key, Mapping(key, key, {})))
    return replace(node, entries=node.entries | {str(step): Entry(old.key, with_value(old.node, rest, value, key))})
