"""``psfcli validate``: the convolution held against rays that scatter by chance."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from psfcli.cli.options import changes_system, directory_for, writes_to
from psfcli.cli.speaking import speaker
from psfcli.config import load

if TYPE_CHECKING:
    from psfcli.config import System
    from psfcli.validation.comparison import Comparison, Extreme

_MOST_TABLES = 12  # images whose table is printed; the CSV has all


class Rays(click.ParamType[int]):
    """A number of rays such as 10000000 or 1e7."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The whole number."""
        try:
            rays = float(value)
        except ValueError:
            rays = 0.0
        if not 1e4 <= rays <= 1e12 or rays != int(rays):
            self.fail(f"{str(value)!r} is no number of rays; allowed: 1e4 to 1e12, whole", param, ctx)
        return int(rays)


@click.command()
@click.argument("config", metavar="CONFIG")
@click.option("--rays", type=Rays(), default="1e7", show_default=True, help="Rays of each image.")
@click.option("--level", type=click.Choice(["third-order", "exact"]), default="third-order", show_default=True)
@click.option("--field", "fields", multiple=True, metavar='"0.3 deg"', help="Replaces fields; repeatable.")
@click.option("--wavelength", metavar='"9.4 nm"', help="Replaces wavelengths.")
@changes_system
@click.option("--seed", type=click.IntRange(0, 2**63), default=0, show_default=True, metavar="S")
@click.option("--jobs", type=click.IntRange(1, 256), default=1, show_default=True, metavar="N", help="Processes.")
@writes_to("<stem>_validation", "validation that stands")
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    rays: int,
    level: str,
    fields: tuple[str, ...],
    wavelength: str | None,
    overrides: tuple[str, ...],
    seed: int,
    jobs: int,
    output: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Hold the convolution against Monte Carlo rays, for every image of CONFIG (- for standard input).

    Rays are deviated by chance at each surface: over third-order aberrations (third-order: are the numbers right?) or
    on exact rays through the surfaces of a prescription (exact: is the model right?). Prints ensquared energies, their
    differences and verdicts, where the method can be trusted, and the paths of validation.csv and of pictures, which
    need matplotlib. The same numbers for the same seed, whatever --jobs. Exit status: 0 agreement, 1 disagreement
    beyond chance with third-order, or no convolution to validate, 2 fault in the usage or the system file, 4 the output
    exists or cannot be written.
    """
    system = load(config, overrides, fields or None, wavelength=wavelength)
    exact = level == "exact"
    if exact and system.prescription is None:
        raise click.UsageError("--level exact needs the surfaces as they are built: a prescription in the system file")
    if exact and not system.telescope.object_at_infinity:
        raise click.UsageError("--level exact needs an object at infinity")
    say = speaker(system, quiet=quiet)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # numpy, scipy: not before the system file is known to be good
    from psfcli.products.report import opened, write_report
    from psfcli.validation import levels, picture, table
    from psfcli.validation.comparison import extreme
    from psfcli.validation.trust import EXACT

    directory = directory_for(output, config, "_validation")
    kind = levels.Level(level)
    with opened(directory, "validation", overwrite=overwrite) as stage:
        images = levels.convolutions(system)  # first, for it takes less than a forecast to tell where there is none
        nearest, farthest = float(images[0][2].ensquared.half_width.min()), levels.farthest_judged(system)
        if nearest > farthest:
            raise click.UsageError(
                f"no square can be judged: the smallest half width is {nearest:.4g} mm, and those beyond "
                f"{farthest:.4g} mm, a tenth of the smallest d_j, reach too near the horizon"
            )
        say(_forecast(system, rays, levels.seconds(system, kind, rays, jobs)))
        bar, progress = _progress(rays * len(system.fields) * len(system.wavelengths), quiet=quiet)
        with bar:
            comparisons = levels.compare(system, kind, rays, seed=seed, jobs=jobs, progress=progress, images=images)
        found = extreme(comparisons)
        criterion = EXACT if exact else found.criterion
        pictures = picture.pictures(system, comparisons, criterion)
        paths, note = write_report(stage, "validation", table.csv_text(comparisons, system, criterion), pictures)
    for comparison in comparisons[:_MOST_TABLES]:
        click.echo(table.name(comparison, system))
        click.echo(table.text_table(comparison, system, criterion) + "\n")
    if len(comparisons) > _MOST_TABLES:
        click.echo(f"... and {len(comparisons) - _MOST_TABLES} more images, all of them in validation.csv\n")
    click.echo("\n".join(_trusted(system, comparisons)) if exact else _summary(found))
    click.echo()
    if note:
        click.echo(note, err=True)
    for path in paths:
        click.echo(path)
    if not (exact or found.explained):
        click.echo("the convolution disagrees with the rays beyond chance", err=True)
        ctx.exit(1)


def _forecast(system: System, rays: int, seconds: float) -> str:
    images = len(system.fields) * len(system.wavelengths)
    return f"{images} image{'s' * (images > 1)} of {rays:.3g} rays: about {seconds:.2g} s"


def _summary(found: Extreme) -> str:
    """The verdict on all boxes together."""
    chance = f"{found.chance:.2g}" if found.chance < 0.995 else "1"
    return (
        f"{'agreement' if found.explained else 'DISAGREEMENT'}: of {found.boxes} energies judged, the largest "
        f"deviation is {found.largest:.2f} standard errors; by chance as large in {chance} of all validations"
    )


def _trusted(system: System, comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Where each image can be trusted, and how many rays were lost."""
    from psfcli.validation.table import name
    from psfcli.validation.trust import EXACT, trust

    yield f"trusted within {EXACT.deviations:g} standard errors or {EXACT.bound:g} of the light:"
    for c in comparisons:
        found = trust(c)
        where = "nowhere" if found.smallest is None else f"half widths from {1e3 * found.smallest:.4g} um"
        yield (
            f"  {name(c, system)}: {where}; largest difference {found.worst:.1e} at {1e3 * found.at:.4g} um; "
            f"{c.estimate.lost:.2%} of the rays lost at the rims of surfaces"
        )


def _progress(total: int, *, quiet: bool) -> tuple[Any, Callable[[int], None] | None]:
    """A progress bar on a terminal, and the callback that moves it; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        return nullcontext(), None
    bar = click.progressbar(length=total, label="rays", file=sys.stderr)
    return bar, bar.update
