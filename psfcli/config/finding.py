"""What a rule between several keys finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from psfcli.config.faults import Steps


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault between keys, told at the value at ``steps`` (``key``: a missing key, told where its parent is named).

    ``problem`` goes on from the value where that is a single one, and stands alone otherwise.
    ``against``: the other values involved; an option that set one of them is blamed.
    """

    steps: Steps
    problem: str
    against: tuple[Steps, ...] = ()
    key: str = ""


def dig(values: Any, *steps: str | int) -> Any:
    """What stands at ``steps`` of the checked values, or None."""
    for step in steps:
        try:
            values = values[step]
        except (KeyError, IndexError, TypeError):
            return None
    return values
