"""The faults of a system file on stderr."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from psfcli.config import ConfigError

MOST = 8
"""Lines printed of one file; more would bury the first."""


def tell(error: ConfigError) -> None:
    """Print the faults, one line each, the first eight of them."""
    for line in error.faults[:MOST]:
        click.echo(line, err=True)
    if len(error.faults) > MOST:
        click.echo(f"... and {len(error.faults) - MOST} more faults", err=True)
