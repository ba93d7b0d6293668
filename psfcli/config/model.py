"""What a system file says, in the units used inside: mm, rad, cycles/mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from psfcli.image.grid import Detector
    from psfcli.surface.surface import Surface
    from psfcli.telescope.prescription import Prescription
    from psfcli.telescope.system import Field, Telescope
    from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class System:
    """A checked system file.

    ``wavelengths`` and ``half_widths`` in mm (``half_widths`` None: the default boxes); ``text`` is the effective
    system file, after all options, as YAML; ``warnings`` are remarks for the user, one line each; ``prescription`` are
    the surfaces as they are built, where the file tells them.
    """

    title: str
    wavelengths: tuple[float, ...]
    telescope: Telescope
    surfaces: tuple[Surface, ...]
    fields: tuple[Field, ...]
    detector: Detector
    half_widths: tuple[float, ...] | None
    tolerance: Tolerance
    text: str
    warnings: tuple[str, ...] = ()
    prescription: Prescription | None = None
