"""Values with units that are options of a command and no part of the system file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from psfcli.config.faults import Faults, Place
from psfcli.config.scalars import quantity
from psfcli.config.tree import Scalar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from psfcli.config.kinds import Quantity


def quantities(option: str, texts: Sequence[str], kind: Quantity) -> tuple[float, ...]:
    """The values [mm, rad] of an option given any number of times, such as ``--incidence "5 deg"``.

    Raises ConfigError with every fault.
    """
    faults, values = Faults(), []
    for number, text in enumerate(texts, start=1):
        place = Place(number, 0, 0, f'{option} "{text}"')
        try:
            values.append(quantity(kind, Scalar(place, text, text)))
        except ValueError as problem:
            faults.add(place, (), str(problem))
    faults.raise_if_any()
    return tuple(values)
