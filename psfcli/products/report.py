"""The files of a report: its pictures and, once they stand, its table."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

from psfcli.products.atomic import Stage, output_errors
from psfcli.products.target import check_target, products_in

Draw = Callable[[BinaryIO], None]


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
    note = (
        "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'"
        if pictures and not drawn
        else ""
    )
    return tuple(stage.directory / name for name in names), note


def _names(stem: str) -> re.Pattern[str]:
    return re.compile(rf"{re.escape(stem)}(_.*)?\.png|{re.escape(stem)}\.csv")
