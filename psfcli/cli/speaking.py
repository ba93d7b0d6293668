"""What commands say on stderr beside errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from psfcli.config import System


def speaker(system: System, *, quiet: bool) -> Callable[[str], None]:
    """A function that prints a line on stderr, unless ``quiet``; the warnings of the ``system`` are its first lines."""

    def say(line: str) -> None:
        if not quiet:
            click.echo(line, err=True)

    tell_warnings(system, quiet=quiet)
    return say


def tell_warnings(system: System, *, quiet: bool = False) -> None:
    """Print the warnings of the ``system`` on stderr, one line each, unless ``quiet``."""
    for warning in () if quiet else system.warnings:
        click.echo(f"warning: {warning}", err=True)
