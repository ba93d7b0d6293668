"""``psfcli plot``: the products of a run as a picture."""

from __future__ import annotations

import sys
from pathlib import Path

import click

_SUFFIX = ".png"


@click.command()
@click.argument("products", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="DIR|FILE.png",
    help="Where to write; default <name of PRODUCTS>.png, also in a DIR.",
)
@click.option("--overwrite", is_flag=True, help="Replace the picture that stands there.")
@click.option(
    "--field", type=click.IntRange(min=0), metavar="N", help="Index of the field whose images are drawn; default last."
)
@click.option(
    "--pixels",
    type=click.IntRange(min=1),
    multiple=True,
    metavar="N",
    help="Images of N x N detector pixels; repeatable, default 4 and 16.",
)
def command(products: Path, output: Path | None, overwrite: bool, field: int | None, pixels: tuple[int, ...]) -> None:
    """Draw what psfcli run wrote into the directory PRODUCTS: images of one field, energies of all fields.

    A row for each wavelength: the image about the Gaussian image point, in colours over decades with contours, and
    ensquared energy against half width, also without aberrations. Nothing is computed. Prints the path of the picture
    (PNG; it needs matplotlib). Exit status: 2 unreadable or not there, 4 the output exists or cannot be written.
    """
    from psfcli.pictures.run import draw
    from psfcli.products.reading import ReadingError, read_rows
    from psfcli.products.report import write_picture

    path = _path(output, products.resolve().name)
    try:
        title, rows = read_rows(products, field, pixels)
    except ReadingError as fault:
        click.echo(f"psfcli plot: {fault}", err=True)
        sys.exit(2)
    write_picture(path, lambda stream: draw(stream, title, rows), overwrite=overwrite)
    click.echo(path)


def _path(output: Path | None, name: str) -> Path:
    """Where the picture goes: FILE.png itself, or into a directory under the name of the products."""
    if output is None:
        return Path(name + _SUFFIX)
    if output.suffix == _SUFFIX and not output.is_dir():
        return output
    if output.suffix and not output.is_dir():
        raise click.UsageError(f"--output {output}: pictures are PNG; name a file *{_SUFFIX}, or a directory")
    return output / (name + _SUFFIX)
