"""Whether products may go into a directory, and which files there are ours."""

from __future__ import annotations

import errno
import os
import re
import shutil
from typing import TYPE_CHECKING

from psfcli.products.atomic import TEMPORARY, OutputError, output_errors

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from psfcli.image.grid import Detector

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


def cube_bytes(detector: Detector, images: int, formats: Sequence[str]) -> int:
    """The room that cubes of so many ``images`` need while they are written."""
    values = sum((detector.pixels * scale) ** 2 for scale in {1, detector.oversample})
    # exr: float32, and the same again until a file is whole
    return images * values * (8 * ("fits" in formats) + 2 * 4 * ("exr" in formats))


def check_room(directory: Path, needed: int) -> None:
    """Raise OutputError where ``directory`` cannot be written, or made, or its disk lacks ``needed`` bytes."""
    with output_errors(directory):
        place = next(path for path in (directory, *directory.absolute().parents) if path.exists())
        if not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "", str(directory))
        if not os.access(place, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "", str(directory))
        free = shutil.disk_usage(place).free
    if needed > free:
        raise OutputError(f"{directory}: the products need {needed:.3g} bytes, the disk has {free:.3g} free")


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
