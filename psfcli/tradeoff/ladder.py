"""The tradeoff of one image: a ladder of accuracies, each held against the truth, and the rivals beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from psfcli import recipe
from psfcli.config.model import System
from psfcli.image.geometric import spot_moments
from psfcli.image.result import FieldImage
from psfcli.telescope.system import Field
from psfcli.tolerance import PRESETS, Tolerance
from psfcli.tradeoff.errors import promised_error
from psfcli.tradeoff.measurement import Measurement, timed
from psfcli.tradeoff.rivals import Limits, measured_rivals

OURS = "psfcli"

_STEPS = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6]  # pixel errors; with each goes a hundredth of it for energies
_EE_PER_PIXEL = 0.01
_TRUTH = Tolerance(0.1 * PRESETS["reference"].pixel, 0.1 * PRESETS["reference"].ee)


@dataclass(frozen=True, slots=True)
class Tradeoff:
    """The measurements of one image, psfcli's from coarse to fine and then the rivals'.

    ``system`` has the one wavelength and the one field of the image; ``truth`` are the errors that the calculation all
    others are held against estimates of itself.
    """

    system: System
    truth: Tolerance
    measurements: tuple[Measurement, ...]


def demanding(system: System) -> System:
    """The system at its shortest wavelength, where most light scatters, and in the field of the largest rms spot."""
    _, rms = spot_moments(system.telescope, system.fields)
    field: Field = system.fields[int(np.hypot(*rms.T).argmax())]
    return replace(system, wavelengths=(min(system.wavelengths),), fields=(field,))


def rungs(*, presets_only: bool) -> dict[str, Tolerance]:
    """The accuracies asked for by name, from coarse to fine; a step that is a preset has the preset's name."""
    steps = (
        {}
        if presets_only
        else {f"{pixel:.0e}".replace("e-0", "e-"): Tolerance(pixel, _EE_PER_PIXEL * pixel) for pixel in _STEPS}
    )
    others = {name: step for name, step in steps.items() if not any(_same(step, preset) for preset in PRESETS.values())}
    return dict(sorted({**PRESETS, **others}.items(), key=lambda rung: -rung[1].pixel))


def measure(system: System, limits: Limits, progress: Callable[[str], None], *, presets_only: bool = False) -> Tradeoff:
    """Measure the tradeoff of the most demanding image of the ``system``; ``progress`` is told each calculation.

    The truth is a calculation asked for a tenth of the errors of ``reference``. Raises SceneError where one of them
    cannot be done.
    """
    image = demanding(system)
    scene = recipe.plan(image)
    if scene.resources.memory > limits.memory:
        raise recipe.SceneError(
            f"an image needs {1e-6 * scene.resources.memory:.0f} MB of memory and may use "
            f"{1e-6 * limits.memory:.0f} MB; "
            "fewer pixels or a smaller oversample would do"
        )
    progress("truth, ten times finer than reference")
    truth = _calculated(image, _TRUTH)
    found = list(_ladder(image, truth, limits.repetitions, progress, presets_only=presets_only))
    found += measured_rivals(scene, truth, limits, progress)
    return Tradeoff(image, truth.reached, tuple(found))


def _ladder(
    image: System, truth: FieldImage, repetitions: int, progress: Callable[[str], None], *, presets_only: bool
) -> Iterator[Measurement]:
    for name, asked in rungs(presets_only=presets_only).items():
        progress(f"{OURS}, {name}")
        run = timed(partial(_calculated, image, asked), repetitions)
        yield Measurement(
            OURS,
            name,
            promised_error(run.answer, truth, image.detector, asked),
            run.seconds,
            run.peak_memory,
            asked,
            run.answer.reached,
        )


def _calculated(system: System, asked: Tolerance) -> FieldImage:
    """The plan, the scatter and the image, with everything the products hold."""
    ((_, _, image),) = recipe.images(recipe.plan(replace(system, tolerance=asked)))
    return image


def _same(a: Tolerance, b: Tolerance) -> bool:
    return abs(a.pixel - b.pixel) < 1e-9 * a.pixel and abs(a.ee - b.ee) < 1e-9 * a.ee
