"""``psfcli plan``: what a scene requires, with numbers; writes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from psfcli.cli.options import Formats, accuracy, system_options
from psfcli.config import load
from psfcli.products import FORMATS

if TYPE_CHECKING:
    from psfcli.config import System
    from psfcli.planning.plan import Plan
    from psfcli.recipe import Trial

_ROWS = 5  # fields shown, and tried, per wavelength


@click.command()
@system_options
@click.option("--format", "formats", type=Formats(), default=",".join(FORMATS), show_default=True, metavar="LIST")
@click.option("--jobs", type=click.IntRange(1, 256), default=1, metavar="N", help="Processes the run would use.")
def command(
    config: str,
    overrides: tuple[str, ...],
    fields: tuple[str, ...],
    accuracy_name: str | None,
    pixel_error: float | None,
    ee_error: float | None,
    formats: tuple[str, ...],
    jobs: int,
) -> None:
    """Say what CONFIG requires: scatter of each surface, spots, light outside the frame, grid, error, time, memory.

    A few of its images are computed in earnest to predict error and time; nothing is written.
    """
    system = load(config, overrides, fields or None, accuracy(accuracy_name, pixel_error, ee_error))
    for warning in system.warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(describe(system, formats, jobs))


def describe(system: System, formats: Sequence[str], jobs: int) -> str:
    """The plan as text."""
    from psfcli import recipe  # numpy, scipy: not before the system file is known to be good

    scene = recipe.plan(system, with_cube=recipe.formats_with_cube(formats), jobs=jobs)
    shown = sorted({round(i * (len(scene.fields) - 1) / (_ROWS - 1)) for i in range(_ROWS)})
    lines = [system.title] if system.title else []
    seconds = 0.0
    worst_pixel = worst_ee = 0.0
    for w in range(len(scene.wavelengths)):
        tried = recipe.trials(scene, w, shown)
        lines += ["", *_wavelength(scene, w, tried)]
        seconds += len(scene.fields) * sum(trial.seconds for trial in tried) / len(tried)
        worst_pixel = max(worst_pixel, *(trial.image.reached.pixel for trial in tried))
        worst_ee = max(worst_ee, *(trial.image.reached.ee for trial in tried))
    images = len(scene.wavelengths) * len(scene.fields)
    lines += [
        "",
        f"images      {images}, of {scene.detector.pixels} x {scene.detector.pixels} pixels of "
        f"{1e3 * scene.detector.pixel:g} um"
        + (f", oversampled {scene.detector.oversample}" if scene.with_cube else ""),
        f"boxes       {scene.half_widths.size}, half widths {1e3 * scene.half_widths[0]:.4g} to "
        f"{1e3 * scene.half_widths[-1]:.6g} um; farthest distance {scene.reach:.4g} mm",
        f"asked       pixel error {scene.tolerance.pixel:.1e}, ensquared energy {scene.tolerance.ee:.1e}",
        f"predicted   pixel error {worst_pixel:.1e}, ensquared energy {worst_ee:.1e}",
        f"time        about {seconds / min(jobs, images):.2g} s beyond start-up, by {jobs} job{'s' * (jobs > 1)}",
        f"memory      {1e-6 * scene.memory:.0f} MB; cubes of {1e-6 * scene.output:.1f} MB",
        *(f"warning     {warning}" for warning in scene.warnings),
    ]
    return "\n".join(lines).lstrip("\n")


def _wavelength(scene: Plan, w: int, tried: Sequence[Trial]) -> Iterator[str]:
    yield (
        f"wavelength {1e6 * scene.wavelengths[w]:.6g} nm: {100.0 * scene.specular_fractions[w]:.4g} % of the light is "
        f"unscattered; the halo is a sum of {tried[0].gaussians} Gaussians"
    )
    yield "  surface         sigma_rel [nm]           g         TIS    d_j [mm]"
    for row in scene.scatter[w]:
        yield (
            f"  {row.name[:14]:14}  {1e6 * row.sigma_rel:14.5g}  {row.g:10.5g}  {row.tis:10.5g}  "
            f"{row.magnified_distance:10.6g}"
        )
    unit, scale = ("deg", math.degrees(1.0)) if scene.telescope.object_at_infinity else ("mm", 1.0)
    yield f"  field [{unit}]    centroid x, y [um]      rms x, y [um]    outside the frame"
    for trial in tried:
        field, spot = scene.fields[trial.field_index], trial.image.spot
        yield (
            f"  {scale * field.radius:9.4g}  {_um(spot.centroid_x):9.3f} {_um(spot.centroid_y):9.3f}  "
            f"{1e3 * spot.rms_x:9.3f} {1e3 * spot.rms_y:8.3f}  {trial.image.power_outside:17.4%}"
        )


def _um(length: float) -> float:
    """A length [mm] in um, to three decimals, with no minus before a zero."""
    return round(1e3 * length, 3) + 0.0
