"""Products: the files a run leaves behind, whole or not at all, and how two of them compare."""

from psfcli.products.atomic import OutputError
from psfcli.products.target import FORMATS

__all__ = ["FORMATS", "OutputError"]
