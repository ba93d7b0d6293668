"""Options of the command line, put into the marked tree as if the file had said them."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

from psfcli.config.faults import Faults, Place, Steps
from psfcli.config.growing import grow
from psfcli.config.paths import follow, with_value
from psfcli.config.tree import Entry, Mapping, Node, Scalar
from psfcli.config.tree import Sequence as Listed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from psfcli.tolerance import Tolerance


def with_options(
    root: Node,
    overrides: Sequence[str],
    fields: Sequence[str] | None,
    tolerance: Tolerance | str | None,
    wavelength: str | None,
    faults: Faults,
) -> Node:
    """The tree after ``--set``, ``--field``, ``--wavelength`` and the accuracy options, in this order.

    ``load`` says what each is.
    """
    number = count(1)

    def place(label: str) -> Place:
        return Place(next(number), 0, 0, label)

    for override in overrides:
        root = _with_override(root, override, place, faults)
    for key, option, texts in (("fields", "--field", fields), ("wavelengths", "--wavelength", [wavelength])):
        given = [text for text in texts or () if text is not None]
        if given:
            places = [place(f'{option} "{text}"') for text in given]
            values = tuple(
                _parsed(text, at, (key, i), faults) for i, (text, at) in enumerate(zip(given, places, strict=True))
            )
            root = with_value(root, (key,), Listed(places[0], values), places[0])
    if isinstance(tolerance, str):
        at = place(f"--accuracy {tolerance}")
        root = with_value(root, ("accuracy",), Scalar(at, tolerance, tolerance), at)
    elif tolerance is not None:
        asked = {"pixel": tolerance.pixel, "ee": tolerance.ee}
        entries = {
            key: Entry(at, Scalar(at, repr(value), value))
            for key, value in asked.items()
            for at in [place(f"--{key}-error {value!r}")]
        }
        at = entries["pixel"].key
        root = with_value(root, ("accuracy",), Mapping(at, at, entries), at)
    return root


def _with_override(root: Node, override: str, place: Callable[[str], Place], faults: Faults) -> Node:
    name, equals, text = override.partition("=")
    name = name.strip()
    at = place(f"--set {name}")
    if not equals or not all(name.split(".")):
        faults.add(at, (), "write it as dotted.key=value, for example surfaces.0.psd.0.sigma=1 nm")
        return root
    steps: Steps = tuple(int(s) if re.fullmatch("[0-9]{1,9}", s) else s for s in name.split("."))
    # the path told is the one found: psd.0 of a single psd is psd itself
    _, found = follow(root, steps)
    value = _parsed(text, at, found, faults)
    try:
        return with_value(root, steps, value, at)
    except ValueError as problem:
        faults.add(at, found, str(problem))
        return root


def _parsed(text: str, at: Place, steps: Steps, faults: Faults) -> Node:
    node = grow(text, lambda _line, _column: at, faults, steps)
    return replace(node, key=at) if isinstance(node, Mapping) else node
