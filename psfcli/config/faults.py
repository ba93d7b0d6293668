"""Faults of a system file: where they stand, in one line each."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

Steps = tuple[str | int, ...]
"""The way from the top of a system file to a value: keys and 0-based indices."""


class ConfigError(Exception):
    """A system file that cannot be used; ``faults`` holds one line for each fault, in the order they stand."""

    def __init__(self, faults: list[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = faults


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """A position in the file (``option`` 0), or the option (1, 2, ...) that said it; ``label`` is how it is told."""

    option: int
    line: int
    column: int
    label: str


def spell(steps: Steps) -> str:
    """The key path of a message, such as ``surfaces[1].psd.C``, always on one line."""
    words = [f"[{step}]" if isinstance(step, int) else "." + _one_line(step) for step in steps]
    return "".join(words).removeprefix(".")


def _one_line(key: str) -> str:
    return key if re.fullmatch(r"[\w<>-]{1,40}", key) else quoted(key)


def quoted(text: str) -> str:
    """The text of a value for a message: in quotes, on one line, cut short."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


@dataclass(slots=True)
class Faults:
    """The faults met so far; a value that stands at several paths (a YAML alias) is told once.

    ``sections``: the keys of the top below which there are any.
    """

    met: dict[tuple[Place, Steps, str], str] = field(default_factory=dict)
    sections: set[str | int] = field(default_factory=set)

    def add(self, place: Place, steps: Steps, problem: str) -> None:
        """Note a fault."""
        path = f"{spell(steps)}: " if steps else ""
        self.sections.update(steps[:1])
        distinct = steps if place.option else steps[-1:]  # an option has one place for all it says
        self.met.setdefault((place, distinct, problem), f"{place.label}: {path}{problem}")

    def raise_if_any(self) -> None:
        """Raise ConfigError with every fault, sorted by position, if there is one."""
        if self.met:
            raise ConfigError([line for (place, _, _), line in sorted(self.met.items(), key=lambda item: item[0][0])])
