"""``psfcli plan``: what a scene requires and what it does not, with numbers; writes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import click

from psfcli.cli.options import MemorySize, asks_for_products, loads_system
from psfcli.cli.speaking import tell_warnings

if TYPE_CHECKING:
    from psfcli.config import System
    from psfcli.planning.effects import Effect
    from psfcli.planning.plan import Plan
    from psfcli.planning.validity import Criterion
    from psfcli.prediction import Trials
    from psfcli.products.header import RunHeader
    from psfcli.tolerance import Tolerance

_MOST_ALIKE = 6  # effects of one kind and state shown; the manifest of a run lists them all


@click.command()
@loads_system
@asks_for_products
def command(config: str, system: System, formats: tuple[str, ...], jobs: int | None, max_memory: float | None) -> None:
    """Say what CONFIG requires and what it does not, why, and the error, time and memory a run would take.

    A few of its images are computed in earnest, and one is written to a temporary directory, to predict error and
    time; nothing stays. Exit status: 2 fault in the usage or the system file, 3 the accuracy cannot be met within
    --max-memory.
    """
    del config
    tell_warnings(system)
    click.echo(describe(system, formats, jobs, max_memory))


def describe(system: System, formats: Sequence[str], jobs: int | None, max_memory: float | None) -> str:
    """The plan as text; ``jobs`` None: as many as pay, ``max_memory`` None: half of the machine's."""
    # numpy, scipy: not before the system file is known to be good
    from psfcli import prediction, recipe

    allowed = max_memory or MemorySize.default()
    scene = recipe.plan_of_products(system, formats, jobs=jobs, max_memory=allowed)
    every = [prediction.trials(scene, w) for w in range(len(scene.wavelengths))]
    worst, needs = prediction.worst(every), scene.resources
    writing = _writing(recipe.header(system, scene), formats, every)
    seconds = prediction.seconds(scene, every) + (writing or 0.0)
    beyond = "start-up" if writing is not None else "start-up and writing"
    asked = scene.tolerance
    lines = [system.title] if system.title else []
    for w, tried in enumerate(every):
        lines += ["", *_wavelength(scene, w, tried)]
    lines += [
        "",
        *_effects(scene.effects),
        "",
        *_validity(scene.validity),
        "",
        f"images      {len(scene.wavelengths) * len(scene.fields)}, of which {len(scene.computations)} computed; "
        f"{scene.detector.pixels} x {scene.detector.pixels} pixels of {1e3 * scene.detector.pixel:g} um"
        + (f", oversampled {scene.detector.oversample}" if scene.with_cube else ", none computed"),
        _boxes(scene),
        f"asked       pixel error {asked.pixel:.1e}, ensquared energy {asked.ee:.1e}",
        f"predicted   {_reached(scene, worst)}",
        f"time        about {seconds:.2g} s beyond {beyond}, by {needs.jobs} job{'s' * (needs.jobs > 1)}",
        f"memory      {1e-6 * needs.memory:.0f} MB of {1e-6 * allowed:.0f} MB allowed; cubes of "
        f"{1e-6 * needs.output:.1f} MB",
    ]
    return "\n".join(lines).lstrip("\n")


def _reached(scene: Plan, worst: Tolerance) -> str:
    asked = scene.tolerance
    pixels = f"pixel error {worst.pixel:.1e}, " if scene.with_cube else ""
    missed = ": not met, a run would end with 3" if worst.pixel > asked.pixel or worst.ee > asked.ee else ""
    return f"{pixels}ensquared energy {worst.ee:.1e}{missed}"


def _writing(header: RunHeader, formats: Sequence[str], every: Sequence[Trials]) -> float | None:
    """The time [s] of writing; None where there is no room to try."""
    from psfcli.products import OutputError
    from psfcli.products.rehearsal import writing_seconds

    image = next(trial.image for trials in every for trial in trials.tried)
    try:
        return writing_seconds(header, formats, image)
    except (OSError, OutputError):
        return None


def _boxes(scene: Plan) -> str:
    widths = 1e3 * scene.half_widths
    which = f", half widths {widths[0]:.4g} to {widths[-1]:.6g} um" if widths.size else ""
    return f"boxes       {widths.size}{which}; farthest distance {scene.reach:.4g} mm"


def _wavelength(scene: Plan, w: int, trials: Trials) -> Iterator[str]:
    halo = f"the halo is a sum of {trials.gaussians} Gaussians" if trials.tried else "its images are computed already"
    yield (
        f"wavelength {1e6 * scene.wavelengths[w]:.6g} nm: {100.0 * scene.specular_fractions[w]:.4g} % of the light is "
        f"unscattered; {halo}"
    )
    yield "  surface         sigma_rel [nm]           g         TIS    d_j [mm]"
    for row in scene.scatter[w]:
        yield (
            f"  {row.name[:14]:14}  {1e6 * row.sigma_rel:14.5g}  {row.g:10.5g}  {row.tis:10.5g}  "
            f"{row.magnified_distance:10.6g}"
        )
    if not trials.tried:
        return
    unit, scale = ("deg", math.degrees(1.0)) if scene.telescope.object_at_infinity else ("mm", 1.0)
    yield f"  field [{unit}]    centroid x, y [um]      rms x, y [um]    outside the frame"
    for trial in trials.tried:
        field, spot, outside = scene.fields[trial.field_index], trial.image.spot, trial.image.power_outside
        yield (
            f"  {scale * field.radius:9.4g}  {_um(spot.centroid_x):9.3f} {_um(spot.centroid_y):9.3f}  "
            f"{1e3 * spot.rms_x:9.3f} {1e3 * spot.rms_y:8.3f}  "
            + ("-" if outside is None else f"{outside:.4%}").rjust(17)
        )


def _effects(effects: Sequence[Effect]) -> Iterator[str]:
    """A table of the effects, the first few of each kind and state."""
    alike = [list(same) for _, same in groupby(effects, key=lambda effect: effect.name.split()[0])]
    shown = [row for same in alike for row in _first_of(same)]
    width = max(len(effect.name) for effect, _ in shown)
    yield f"{'effect':{width}}  {'':8}  {'energy':>7}  {'pixel':>7}  because"
    for effect, more in shown:
        state = "modelled" if effect.modelled else "skipped"
        saved = f"; saves {effect.saves}" if not effect.modelled and effect.saves != "nothing" else ""
        why = effect.because + saved
        yield (f"{effect.name:{width}}  {state:8}  {_bound(effect.ee):>7}  {_bound(effect.pixel):>7}  {why}")
        if more:
            yield f"{'':{width}}  ... and {more} more {state}, all of them in the manifest of a run"


def _validity(criteria: Sequence[Criterion]) -> Iterator[str]:
    """A table of the criteria: how far the model itself can be trusted."""
    width = max(len(criterion.name) for criterion in criteria)
    yield f"{'validity of the model':{width}}    value  at most"
    for each in criteria:
        value = "unknown" if math.isnan(each.value) else f"{each.value:.2g}"
        limit = f"{each.threshold:g}" if math.isfinite(each.threshold) else "-"
        mark = "" if each.ok else "warning: "
        yield f"{each.name:{width}}  {value:>7}  {limit:>7}  {mark}{each.advice}"


def _first_of(alike: Sequence[Effect]) -> Iterator[tuple[Effect, int]]:
    """The first effects of each state, and after the last of them how many more there are."""
    for modelled in (True, False):
        same = [effect for effect in alike if effect.modelled == modelled]
        for place, effect in enumerate(same[:_MOST_ALIKE], start=1):
            yield effect, len(same) - place if place == _MOST_ALIKE else 0


def _bound(change: float) -> str:
    """A bound of a change: none where there is none, 0 where nothing changes."""
    return "0" if change == 0.0 else f"{change:.1e}" if math.isfinite(change) else "-"


def _um(length: float) -> float:
    """A length [mm] in um, to three decimals, with no minus before a zero."""
    return round(1e3 * length, 3) + 0.0
