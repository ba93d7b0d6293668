"""``psfcli run``: the main job."""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from psfcli.cli.options import MemorySize, asks_for_products, directory_for, loads_system, writes_to
from psfcli.cli.speaking import speaker

if TYPE_CHECKING:
    from psfcli.config import System


@click.command()
@loads_system
@writes_to("<config stem>_psf", "products that stand", quiet="No reports on stderr but errors.")
@asks_for_products
@click.option("--dry-run", is_flag=True, help="Say what would be computed, as psfcli plan does; write nothing.")
@click.option("-v", "--verbose", is_flag=True, help="Report time and processes too.")
@click.pass_context
def command(
    ctx: click.Context,
    config: str,
    system: System,
    output: Path | None,
    formats: tuple[str, ...],
    jobs: int | None,
    max_memory: float | None,
    overwrite: bool,
    dry_run: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Compute PSF cubes and ensquared energy for every wavelength and field of CONFIG (- for standard input).

    Prints the paths written. Exit status: 0 done, 1 failed, 2 fault in the usage or the system file, 3 the accuracy
    asked for was not met (the products say so), 4 the output exists or cannot be written, 130 interrupted.
    """
    directory = directory_for(output, config, "_psf")
    say = speaker(system, quiet=quiet)
    if dry_run:
        from psfcli.cli.plan import describe
        from psfcli.products.target import check_room, check_target, cube_bytes

        check_target(directory, overwrite=overwrite)
        images = len(system.fields) * len(system.wavelengths)
        check_room(directory, cube_bytes(system.detector, images, formats))
        click.echo(describe(system, formats, jobs, max_memory))
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no idle threads; the recipe sees to the rest
    from psfcli import recipe  # numpy, scipy: not before the system file is known to be good

    bar, progress = _progress(quiet)
    with bar:
        outcome = recipe.write(
            system,
            directory,
            formats=formats,
            overwrite=overwrite,
            jobs=jobs,
            max_memory=max_memory or MemorySize.default(),
            command=shlex.join(["psfcli", *sys.argv[1:]]),
            input_name=config,
            input_sha256=hashlib.sha256(
                system.text.encode() if config == "-" else Path(config).read_bytes()
            ).hexdigest(),
            progress=progress,
        )
    for note in outcome.notes:
        say(f"note: {note}")
    asked, reached = system.tolerance, outcome.reached
    pixels = f"pixel error {reached.pixel:.2g} (asked {asked.pixel:.2g}), " if recipe.formats_with_cube(formats) else ""
    say(f"reached: {pixels}ensquared energy {reached.ee:.2g} (asked {asked.ee:.2g})")
    if verbose:
        images, jobs = len(system.fields) * len(system.wavelengths), outcome.jobs
        say(f"{images} images by {jobs} process{'es' * (jobs > 1)}, {outcome.seconds:.2f} s beyond start-up")
    for path in outcome.paths:
        click.echo(path)
    if reached.pixel > asked.pixel or reached.ee > asked.ee:
        click.echo("the accuracy asked for was not met; ERRPIX and ERREE say what was", err=True)
        ctx.exit(3)


def _progress(quiet: bool) -> tuple[Any, Callable[[int, int], None] | None]:
    """A progress bar on a terminal, and the callback that moves it; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        from contextlib import nullcontext

        return nullcontext(), None
    bar = click.progressbar(length=1, label="images", file=sys.stderr)

    def move(done: int, total: int) -> None:
        bar.length = total
        bar.update(done - bar.pos)

    return bar, move
