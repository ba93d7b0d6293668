"""The files of a tradeoff: the picture and, once it stands, the table."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from psfcli.products.atomic import Stage, output_errors
from psfcli.products.target import check_target
from psfcli.tradeoff.ladder import Tradeoff
from psfcli.tradeoff.table import csv_text

TABLE, PICTURE = "tradeoff.csv", "tradeoff.png"
_NAMES = re.compile(r"tradeoff\.(csv|png)")


@contextmanager
def opened(directory: Path, *, overwrite: bool) -> Iterator[Stage]:
    """Hold ``directory`` for one tradeoff: what ``write`` does not commit leaves no trace. Raises OutputError."""
    with output_errors(directory):
        check_target(directory, overwrite=overwrite, names=_NAMES, last=TABLE)
        stage = Stage(directory)
    try:
        yield stage
    finally:
        stage.close()


def write(stage: Stage, tradeoff: Tradeoff, title: str) -> tuple[tuple[Path, ...], str]:
    """Put picture and table in place, each wholly or not at all; the paths, and a note for the user or nothing.

    Without matplotlib there is no picture, an old one is removed, and the note says so. Raises OutputError.
    """
    with output_errors(stage.directory):
        drawn = _draw(stage, tradeoff, title)
        stage.digests()
        stage.commit(TABLE, csv_text(tradeoff.measurements).encode(), [] if drawn else [PICTURE])
    if drawn:
        return (stage.directory / PICTURE, stage.directory / TABLE), ""
    return (stage.directory / TABLE,), "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'"


def _draw(stage: Stage, tradeoff: Tradeoff, title: str) -> bool:
    try:
        import matplotlib  # noqa: F401 - asked for before a file is opened
    except ImportError:
        return False
    from psfcli.tradeoff.picture import draw

    draw(stage.open(PICTURE), title, tradeoff.measurements)
    return True
