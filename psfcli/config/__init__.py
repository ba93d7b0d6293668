"""The system file: text -> marked tree -> frozen models. Units are converted here, once."""

from psfcli.config.angles import angles
from psfcli.config.faults import ConfigError
from psfcli.config.json_schema import schema
from psfcli.config.loading import load
from psfcli.config.model import System
from psfcli.config.reference_text import reference
from psfcli.config.scalars import wavelengths_in
from psfcli.config.table import SCATTER_INCIDENCE, SCATTER_PLANE

__all__ = [
    "SCATTER_INCIDENCE",
    "SCATTER_PLANE",
    "ConfigError",
    "System",
    "angles",
    "load",
    "reference",
    "schema",
    "wavelengths_in",
]
