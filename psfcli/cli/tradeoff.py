"""``psfcli tradeoff``: what accuracy costs on one's own scene and machine, beside what one would do otherwise."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from psfcli.cli.options import Amount, MemorySize, changes_system, directory_for, writes_to
from psfcli.cli.speaking import speaker
from psfcli.config import load
from psfcli.products.units import field_name

if TYPE_CHECKING:
    from psfcli.config import System

_QUICK_SECONDS = 1.0
_FULL_SECONDS = 20.0


@click.command()
@click.argument("config", metavar="CONFIG")
@changes_system
@click.option("--field", metavar='"0.3 deg"', help="Default: the field of CONFIG with the largest spot.")
@click.option("--wavelength", metavar='"9.4 nm"', help="Default: the shortest of CONFIG, where most light scatters.")
@click.option("--quick", is_flag=True, help="The three accuracies with a name, small rivals, everything timed once.")
@click.option(
    "--max-seconds",
    type=Amount(min=0.0, min_open=True),
    metavar="S",
    help=f"Rivals that would take longer are left out; default {_FULL_SECONDS:g}, with --quick {_QUICK_SECONDS:g}.",
)
@writes_to("<config stem>_tradeoff", "tradeoff that stands")
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    overrides: tuple[str, ...],
    field: str | None,
    wavelength: str | None,
    quick: bool,
    max_seconds: float | None,
    output: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Measure what accuracy costs: errors, time and memory of one image of CONFIG (- for standard input).

    One image, at one wavelength and one field, is calculated at a ladder of accuracies, and by a plain FFT, by Monte
    Carlo and by counting rays. Prints the table and the paths of tradeoff.csv and tradeoff.png (error against time;
    it needs matplotlib). Exit status as of psfcli run; 3: psfcli did not meet an accuracy.
    """
    system = load(config, overrides, [field] if field else None, wavelength=wavelength)
    say = speaker(system, quiet=quiet)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # every method on one thread
    # numpy, scipy: not before the system file is known to be good
    from psfcli.products.report import opened, write_report
    from psfcli.tradeoff import ladder, picture, table
    from psfcli.tradeoff.rivals import Limits

    directory = directory_for(output, config, "_tradeoff")
    limits = Limits(
        seconds=max_seconds or (_QUICK_SECONDS if quick else _FULL_SECONDS),
        memory=MemorySize.default(),
        repetitions=1 if quick else 3,
    )
    with opened(directory, "tradeoff", overwrite=overwrite) as stage:
        found = ladder.measure(system, limits, say, presets_only=quick)
        title = _title(found.system)
        pictures = {"tradeoff.png": lambda stream: picture.draw(stream, title, found.measurements)}
        paths, note = write_report(stage, "tradeoff", table.csv_text(found.measurements), pictures)
    click.echo(title)
    click.echo(
        f"errors against a calculation that estimates its own as {found.truth.pixel:.0e} of a pixel "
        f"and {found.truth.ee:.0e} of an ensquared energy\n"
    )
    click.echo(table.text_table(found.measurements) + "\n")
    if note:
        click.echo(note, err=True)
    for path in paths:
        click.echo(path)
    missed = [m.setting for m in found.measurements if not m.met]
    if missed:
        click.echo(f"the accuracy asked for was not met: {', '.join(missed)}", err=True)
        ctx.exit(3)


def _title(system: System) -> str:
    """What is measured: the scene and the one image of it."""
    (field,), (wavelength,), detector = system.fields, system.wavelengths, system.detector
    place = field_name(field.radius, field.azimuth, at_infinity=system.telescope.object_at_infinity)
    return (
        f"{system.title or 'Untitled system'}: {1e6 * wavelength:.6g} nm, field {place}, "
        f"{detector.pixels} x {detector.pixels} pixels, oversample {detector.oversample}"
    )
