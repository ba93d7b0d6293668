"""Whether products may go into a directory, and which files there are ours."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from psfcli.products.atomic import TEMPORARY, OutputError

if TYPE_CHECKING:
    from pathlib import Path

FORMATS = ("fits", "exr", "csv")
FITS = "psf.fits"
EE_TABLE = "ee.csv"
MANIFEST = "manifest.json"
_NAMES = re.compile(r"psf\.fits|psf(_\d{3,})?\.exr|ee\.csv|manifest\.json")


def products_in(directory: Path, names: re.Pattern[str] = _NAMES) -> list[str]:
    """The names of the products in ``directory``, in order; none when it does not exist."""
    if not directory.is_dir():
        return []
    return sorted(p.name for p in directory.iterdir() if names.fullmatch(p.name))


def check_target(directory: Path, *, overwrite: bool, names: re.Pattern[str] = _NAMES, last: str = MANIFEST) -> None:
    """Raise OutputError unless products may go into ``directory``: it is new or empty, or ``overwrite`` is asked.

    ``names`` are those of the products, ``last`` the one without which they are incomplete.
    """
    if directory.exists() and not directory.is_dir():
        raise OutputError(f"{directory}: is a file, not a directory; choose another --output")
    ours = products_in(directory, names)
    for name in ours:
        if (directory / name).is_dir():
            raise OutputError(f"{directory / name}: is a directory where a product must go; choose another --output")
    if overwrite or not directory.is_dir():
        return
    if ours and last not in ours:
        raise OutputError(f"{directory}: holds an incomplete run (no {last}); --overwrite completes it")
    if ours:
        raise OutputError(f"{directory}: already holds products; --overwrite replaces them")
    if any(not p.name.startswith(TEMPORARY) for p in directory.iterdir()):
        raise OutputError(f"{directory}: is not empty; choose another --output, or --overwrite to write into it")
