"""``psfcli bsdf``: how the surfaces of a system scatter, at any incidence and into the whole hemisphere."""

from __future__ import annotations

import math
from pathlib import Path

import click

from psfcli.cli.options import changes_system, directory_for, writes_to
from psfcli.cli.speaking import tell_warnings
from psfcli.config import SCATTER_INCIDENCE, SCATTER_PLANE, load, quantities


@click.command()
@click.argument("config", metavar="CONFIG")
@changes_system
@click.option("--surface", "names", multiple=True, metavar="NAME", help="Only this surface; repeatable.")
@click.option(
    "--incidence",
    "incidences",
    multiple=True,
    default=("0 deg", "2 deg", "5 deg"),
    show_default=True,
    metavar='"5 deg"',
    help="Angle of incidence, 0 to 89 deg; repeatable.",
)
@click.option(
    "--plane",
    default="0 deg",
    show_default=True,
    metavar='"90 deg"',
    help="Azimuth of the plane of scatter, which holds the normal, from the plane of incidence.",
)
@click.option("--wavelength", metavar='"9.4 nm"', help="Default: the shortest of CONFIG, where most light scatters.")
@writes_to("<config stem>_bsdf", "profiles that stand")
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    overrides: tuple[str, ...],
    names: tuple[str, ...],
    incidences: tuple[str, ...],
    plane: str,
    wavelength: str | None,
    output: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write profiles of the BSDF of the surfaces of CONFIG (- for standard input), and a picture of them.

    Prints TIS at each incidence, its change from normal incidence (dTIS), the factor of renormalisation R, and how far
    the BSDF departs from that of normal incidence within three distances |beta - beta_0|; then the paths of bsdf.csv
    and bsdf.png (which needs matplotlib). The incidence of the system file is not used.
    """
    incidence = quantities("--incidence", incidences, SCATTER_INCIDENCE)
    (azimuth,) = quantities("--plane", [plane], SCATTER_PLANE)
    system = load(config, overrides, wavelength=wavelength)
    surfaces = [surface for surface in system.surfaces if not names or surface.name in names]
    if not system.surfaces:
        raise click.UsageError(f"{config}: the system has no surfaces, and so no BSDF")
    unknown = [name for name in names if name not in {surface.name for surface in surfaces}]
    if unknown:
        known = ", ".join(surface.name for surface in system.surfaces)
        raise click.UsageError(f"--surface: {', '.join(map(repr, unknown))} unknown; allowed: {known}")
    tell_warnings(system, quiet=quiet)
    # numpy, scipy: not before the system file is known to be good
    from psfcli.products.report import opened, write_report
    from psfcli.scattering import picture, profile, table

    shortest = min(system.wavelengths)
    directory = directory_for(output, config, "_bsdf")
    title = f"{system.title or 'Untitled system'}: {1e6 * shortest:.6g} nm" + (
        f", plane of scatter at {math.degrees(azimuth):.6g}°" if azimuth else ""
    )
    with opened(directory, "bsdf", overwrite=overwrite) as stage:
        try:
            found = profile.profiles(surfaces, shortest, list(dict.fromkeys(incidence)), azimuth)
        except profile.ProfileError as problem:
            click.echo(str(problem), err=True)
            ctx.exit(2 if problem.usage else 1)
        rough = [one for one in found if one.bsdf.any()]
        pictures = {"bsdf.png": lambda stream: picture.draw(stream, title, rough)} if rough else {}
        paths, note = write_report(stage, "bsdf", table.csv_text(found), pictures)
    click.echo(f"{title}\n\n{table.text_table(found)}\n")
    if note:
        click.echo(note, err=True)
    for path in paths:
        click.echo(path)
