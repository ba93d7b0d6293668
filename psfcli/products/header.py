"""What the products say of a run besides its images."""

from __future__ import annotations

import hashlib
import platform
import sys
import unicodedata
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING

from psfcli.products.units import DEG, converted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from psfcli.image.grid import Detector
    from psfcli.image.result import EnsquaredEnergy, FieldImage, Spot, SurfaceScatter
    from psfcli.telescope.system import Field, Telescope
    from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class RunHeader:
    """A run before its first image.

    ``wavelengths`` [mm] and ``specular_fractions`` (of all light) have one entry per wavelength; ``throughput``
    is the product of the reflectances; ``surfaces`` holds one row per wavelength and surface; ``tolerance`` is
    what was asked; ``config`` is the effective system file; ``command`` the command line; ``input_name`` and
    ``input_sha256`` name the system file as the user gave it; ``plan`` is for the manifest alone and must be
    what JSON holds; ``warnings`` say where the model itself may mislead, one line each.
    """

    title: str
    wavelengths: tuple[float, ...]
    specular_fractions: tuple[float, ...]
    throughput: float
    telescope: Telescope
    surfaces: tuple[SurfaceScatter, ...]
    fields: tuple[Field, ...]
    detector: Detector
    tolerance: Tolerance
    config: str
    command: str
    input_name: str
    input_sha256: str
    plan: Mapping[str, object]
    warnings: tuple[str, ...] = ()

    @property
    def config_sha256(self) -> str:
        """The sha256 of ``config`` as UTF-8, in hexadecimal."""
        return hashlib.sha256(self.config.encode()).hexdigest()

    @property
    def field_unit(self) -> str:
        """The unit of fields in the products: deg for an object at infinity, else mm."""
        return "deg" if self.telescope.object_at_infinity else "mm"

    def field_value(self, radius: float) -> float:
        """A field radius [rad or mm] in ``field_unit``."""
        return converted(radius, DEG if self.telescope.object_at_infinity else 1.0)


@dataclass(frozen=True, slots=True)
class ImageSummary:
    """What is kept of an image once its planes are written.

    ``power_in_frame`` is the sum of its PSF, ``power_outside`` the rest (None: no cube was asked for).
    """

    wavelength_index: int
    field_index: int
    spot: Spot
    ensquared: EnsquaredEnergy
    power_in_frame: float | None
    power_outside: float | None
    reached: Tolerance

    @classmethod
    def of(cls, wavelength_index: int, field_index: int, image: FieldImage) -> ImageSummary:
        """The summary of ``image``."""
        inside = None if image.psf is None else float(image.psf.sum())
        return cls(
            wavelength_index, field_index, image.spot, image.ensquared, inside, image.power_outside, image.reached
        )


@cache
def versions() -> dict[str, str]:
    """The versions of psfcli and of what computes and writes for it, by name."""
    packages = {name: _version(name) for name in ("psfcli", "numpy", "scipy", "astropy")}
    return {**packages, "python": platform.python_version()}


def _version(package: str) -> str:
    # what is loaded knows it; what is installed is asked ten times as slowly
    return getattr(sys.modules.get(package), "__version__", None) or version(package)


def ascii_line(text: str) -> str:
    """``text`` as one line of printable ASCII: accents dropped, other characters escaped."""
    decomposed = unicodedata.normalize("NFKD", " ".join(text.split()))
    plain = "".join(c for c in decomposed if not unicodedata.combining(c))
    escaped = plain.encode("ascii", "backslashreplace").decode()
    return "".join(c if c.isprintable() else "?" for c in escaped)
