"""``psfcli check``: validate system files, and nothing else."""

from __future__ import annotations

import click

from psfcli.cli.faults import tell
from psfcli.config import ConfigError, load


@click.command()
@click.argument("configs", metavar="CONFIG...", nargs=-1, required=True)
@click.pass_context
def command(ctx: click.Context, configs: tuple[str, ...]) -> None:
    """Validate system files; a file may be - for standard input.

    Prints "CONFIG: ok" for each good file and every fault of the others; exit code 2 if there is any.
    """
    bad = False
    for config in configs:
        try:
            system = load(config)
        except ConfigError as error:
            tell(error)
            bad = True
        else:
            for warning in system.warnings:
                click.echo(f"{config}: warning: {warning}", err=True)
            click.echo(f"{'<stdin>' if config == '-' else config}: ok")
    ctx.exit(2 if bad else 0)
