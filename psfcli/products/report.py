"""The files of a report: its pictures and, once they stand, its table; and a picture that stands alone."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from psfcli.products.atomic import OutputError, Stage, output_errors
from psfcli.products.target import check_target, products_in

Draw = Callable[[BinaryIO], None]
NO_PICTURE = "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'"


@contextmanager
def opened(directory: Path, stem: str, *, overwrite: bool) -> Iterator[Stage]:
    """Hold ``directory`` for one report: what ``write_report`` does not commit leaves no trace. Raises OutputError.

    The files are called ``stem``.csv, ``stem``.png and ``stem``_*.png.
    """
    with output_errors(directory):
        check_target(directory, overwrite=overwrite, names=_names(stem), last=f"{stem}.csv")
        stage = Stage(directory)
    try:
        yield stage
    finally:
        stage.close()


def write_report(stage: Stage, stem: str, table: str, pictures: Mapping[str, Draw]) -> tuple[tuple[Path, ...], str]:
    """Put pictures, by name, and the ``table`` in place, all or none; the paths, and a note for the user or nothing.

    Without matplotlib there are no pictures, and the note says so. Old files of the report go. Raises OutputError.
    """
    last, drawn = f"{stem}.csv", bool(find_spec("matplotlib"))
    with output_errors(stage.directory):
        for name, draw in pictures.items() if drawn else ():
            draw(stage.open(name))
        stage.digests()
        names = [*pictures, last] if drawn else [last]
        stage.commit(
            last, table.encode(), [old for old in products_in(stage.directory, _names(stem)) if old not in names]
        )
    note = NO_PICTURE if pictures and not drawn else ""
    return tuple(stage.directory / name for name in names), note


def write_picture(path: Path, draw: Draw, *, overwrite: bool) -> None:
    """Put one picture in place, whole or not at all. Raises OutputError, also without matplotlib."""
    if not find_spec("matplotlib"):
        raise OutputError(NO_PICTURE)
    if path.is_dir():
        raise OutputError(f"{path}: is a directory where a picture must go; choose another --output")
    if path.parent.exists() and not path.parent.is_dir():
        raise OutputError(f"{path.parent}: is a file, not a directory; choose another --output")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; --overwrite replaces it")
    with output_errors(path.parent):
        stage = Stage(path.parent)
        try:
            draw(drawn := BytesIO())
            stage.commit(path.name, drawn.getvalue())
        finally:
            stage.close()


def _names(stem: str) -> re.Pattern[str]:
    return re.compile(rf"{re.escape(stem)}(_.*)?\.png|{re.escape(stem)}\.csv")
