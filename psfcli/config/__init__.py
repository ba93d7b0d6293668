"""The system file: text -> marked tree -> frozen models. Units are converted here, once."""

from psfcli.config.faults import ConfigError
from psfcli.config.json_schema import schema
from psfcli.config.loading import load
from psfcli.config.model import System
from psfcli.config.quantities import quantities
from psfcli.config.reference_text import reference
from psfcli.config.table import SCATTER_INCIDENCE, SCATTER_PLANE, WAVELENGTH

__all__ = [
    "SCATTER_INCIDENCE",
    "SCATTER_PLANE",
    "WAVELENGTH",
    "ConfigError",
    "System",
    "load",
    "quantities",
    "reference",
    "schema",
]
