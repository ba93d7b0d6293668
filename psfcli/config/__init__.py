"""The system file: text -> marked tree -> frozen models. Units are converted here, once."""

from psfcli.config.faults import ConfigError
from psfcli.config.json_schema import schema
from psfcli.config.loading import load
from psfcli.config.model import System
from psfcli.config.reference_text import reference
from psfcli.config.scalars import wavelengths_in

__all__ = ["ConfigError", "System", "load", "reference", "schema", "wavelengths_in"]
