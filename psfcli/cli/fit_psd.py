"""``psfcli fit-psd``: measured spectra of a surface to the K-correlation that fits them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from psfcli.cli.options import Amount, directory_for, writes_to
from psfcli.config import WAVELENGTH, load, quantities
from psfcli.config.measured import image_bands, psd_block, unmeasured
from psfcli.config.spectra import Stated, read_spectra
from psfcli.metrology.measurement import GAIN_ERROR, KINDS, MOST_TERMS

if TYPE_CHECKING:
    from psfcli.config import System

_STEM = "fit_psd"


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--terms", type=click.IntRange(1, MOST_TERMS), default=1, show_default=True, help="Terms, which add.")
@click.option("--kind", type=click.Choice(KINDS), help="Of the files that do not say.")
@click.option("--frequency-unit", metavar="UNIT", help="Of the files that do not say, such as 1/mm.")
@click.option("--psd-unit", metavar="UNIT", help="Of the files that do not say, such as 'nm2 mm2'.")
@click.option(
    "--gain-error",
    type=Amount(0.0, 1.0, min_open=True),
    metavar="X",
    help=f"Standard error of the gain of each instrument's PSD, relative; default {GAIN_ERROR:g}.",
)
@click.option("--no-offsets", is_flag=True, help="No gains: all instruments are taken to agree.")
@click.option(
    "--wavelength",
    "wavelengths",
    multiple=True,
    metavar='"9.4 nm"',
    help="Tell rms and TIS of what scatters there; repeatable; default: those of --config.",
)
@click.option("--config", metavar="CONFIG", help="A system file: warn of what its image uses and nobody measured.")
@writes_to("<stem of FILE>_fit", "fit that stands")
@click.pass_context
def command(
    ctx: click.Context,
    files: tuple[str, ...],
    terms: int,
    kind: str | None,
    frequency_unit: str | None,
    psd_unit: str | None,
    gain_error: float | None,
    no_offsets: bool,
    wavelengths: tuple[str, ...],
    config: str | None,
    output: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Fit a K-correlation, or a sum of them, to measured power spectral densities.

    Each FILE holds what one instrument measured: two columns, frequency and psd, with their units and the kind of
    spectrum in a header. Prints a psd block for a system file, and as comments the paths of fit_psd.csv and fit_psd.png
    (which needs matplotlib); the report goes to stderr. Exit status: 1 the data leave a parameter open, 2 a fault in
    the usage or in a file, 4 the output exists or cannot be written.
    """
    if no_offsets and gain_error is not None:
        raise click.UsageError("--no-offsets excludes --gain-error")
    if config == "-" and "-" in files:
        raise click.UsageError("standard input (-) is one file: name the others")
    asked = quantities("--wavelength", wavelengths, WAVELENGTH)
    system = None if config is None else load(config)
    spectra = read_spectra(files, Stated(kind or "", frequency_unit or "", psd_unit or ""))
    # numpy, scipy: not before the files are known to be good
    from psfcli.metrology import picture, report, table
    from psfcli.metrology.fit import fit
    from psfcli.metrology.resolution import FitError
    from psfcli.products.report import opened, write_report

    gain = 0.0 if no_offsets else GAIN_ERROR if gain_error is None else gain_error
    directory = directory_for(output, files[0], "_fit")
    with opened(directory, _STEM, overwrite=overwrite) as stage:
        try:
            found = fit(spectra, terms, gain)
        except FitError as error:
            click.echo(str(error), err=True)
            ctx.exit(1)
        used = image_bands(system) if system else {}
        pictures = {f"{_STEM}.png": lambda stream: picture.draw(stream, found, list(used.values()))}
        paths, note = write_report(stage, _STEM, table.csv_text(found), pictures)
    if not quiet:
        remarks = [*report.warnings(found, gain), *_unmeasured(system, [one.band for one in spectra])]
        at = asked or (system.wavelengths if system else ())
        for line in (*report.lines(found, at), *(f"warning: {remark}" for remark in remarks)):
            click.echo(line, err=True)
    if note:
        click.echo(note, err=True)
    click.echo(psd_block(found))
    for path in paths:
        click.echo(f"# {path}")


def _unmeasured(system: System | None, bands: list[tuple[float, float]]) -> list[str]:
    return list(unmeasured(system, dict.fromkeys(range(len(system.surfaces)), bands))) if system else []
