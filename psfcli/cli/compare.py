"""``psfcli compare``: whether two products agree within what they promise."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from psfcli.cli.options import Amount
from psfcli.products.compare import Comparison, ComparisonError, compare
from psfcli.tolerance import Tolerance


@click.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("--pixel-error", type=Amount(min=0.0), metavar="X", help="Allowed relative error of a pixel.")
@click.option("--ee-error", type=Amount(min=0.0), metavar="Y", help="Allowed error of an ensquared energy.")
def command(a: Path, b: Path, pixel_error: float | None, ee_error: float | None) -> None:
    """Compare the products A and B: directories, FITS files or CSV files.

    Allowed is, unless told, the sum of the accuracies the two were asked for. Exit status: 0 within, 1 beyond,
    2 unreadable or of different shape.
    """
    if (pixel_error is None) != (ee_error is None):
        raise click.UsageError("--pixel-error and --ee-error come together")
    tolerance = None if pixel_error is None or ee_error is None else Tolerance(pixel_error, ee_error)
    try:
        comparison = compare(a, b, tolerance)
    except ComparisonError as fault:
        click.echo(f"psfcli compare: {fault}", err=True)
        sys.exit(2)
    click.echo(_report(comparison))
    sys.exit(0 if comparison.within else 1)


def _report(comparison: Comparison) -> str:
    differing = [d for d in comparison.differences if d.absolute > 0.0]
    width = max((len(d.name) for d in differing), default=0)
    lines = [f"{'':{width}}  {'absolute':>9}  {'relative':>9}  {'/ allowed':>9}  beyond"] if differing else []
    for d in differing:
        count = f"{d.beyond} of {d.values}" if d.beyond else "-"
        lines.append(f"{d.name:{width}}  {d.absolute:9.2e}  {d.relative:9.2e}  {d.share:9.2e}  {count}")
    allowed = comparison.tolerance
    verdict = "within" if comparison.within else "beyond"
    return "\n".join(
        [
            *lines,
            f"{len(comparison.differences) - len(differing)} of {len(comparison.differences)} parts are identical",
            f"{verdict} what is allowed: pixel error {allowed.pixel:.3g}, ensquared-energy error {allowed.ee:.3g}",
        ]
    )
