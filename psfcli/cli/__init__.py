"""The command line: parse, call one function, report."""

from __future__ import annotations

import errno
import gc
import importlib
import os
import sys

import click

_COMMANDS = {
    "run": "Compute PSF cubes and ensquared energy for every wavelength and field.",
    "plan": "Say what a run would compute, how exact, how long; writes nothing.",
    "check": "Validate system files.",
    "seidel": "Print each surface's aberrations and the first-order optics of a telescope.",
    "tradeoff": "Measure what accuracy costs on a scene, beside FFT and ray counting.",
    "validate": "Hold the convolution against Monte Carlo rays.",
    "bsdf": "Profiles of the BSDF at any incidence, and how shift-invariant it is.",
    "fit-psd": "Fit K-correlations to measured spectra of a surface.",
    "plot": "Draw the products of a run: images and ensquared energy.",
    "compare": "Measure the differences between two products.",
    "schema": "Print the JSON Schema of the system file.",
}


# made between two searches for garbage: imports make many and leave none, and Python would search them a hundred times
_OBJECTS = 200_000


class _Commands(click.Group):
    """The commands by name, each imported only when it is called, and the errors they end with."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names, in the order of the help."""
        del ctx
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, or None."""
        del ctx
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"psfcli.cli.{cmd_name.replace('-', '_')}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing them."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; what users can act on becomes lines on stderr and an exit code, a bug its traceback."""
        gc.set_threshold(_OBJECTS)
        try:
            answer = super().invoke(ctx)
            sys.stdout.flush()
            return answer
        except KeyboardInterrupt:
            click.echo("interrupted", err=True)
            ctx.exit(130)
        except Exception as error:
            code = _told(error)
            if code is None:
                raise
            ctx.exit(code)


def _told(error: Exception) -> int | None:
    """The exit code of an error after telling it, or None for one that is a bug."""
    # imported only now, so that help stays quick
    from psfcli.cli.faults import tell
    from psfcli.config import ConfigError
    from psfcli.products import OutputError

    if isinstance(error, ConfigError):
        tell(error)
        return 2
    if isinstance(error, OSError) and error.filename is None and error.errno in (errno.ENOSPC, errno.EIO, errno.EFBIG):
        click.echo(f"standard output cannot be written: {error.strerror}", err=True)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is still buffered has nowhere to go
        return 4
    if isinstance(error, OutputError):
        click.echo(str(error), err=True)
        return 4
    recipe = sys.modules.get("psfcli.recipe")
    if recipe is not None and isinstance(error, recipe.SceneError):
        click.echo(str(error), err=True)
        return 3 if isinstance(error, recipe.AccuracyUnreachable) else 1
    return None


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="psfcli")
def main() -> None:
    """Telescope PSFs and ensquared energy: aberrations and surface scatter together."""
