"""``psfcli schema``: the JSON Schema of the system file."""

from __future__ import annotations

import json

import click

from psfcli.config import schema


@click.command()
def command() -> None:
    """Print the JSON Schema of the system file, for editors that check and complete while one types."""
    click.echo(json.dumps(schema(), indent=2))
