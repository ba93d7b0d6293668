"""The two levels of a validation: rays of third-order geometry, which test the numerics, and exact rays (the model)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from psfcli import recipe
from psfcli.config.model import System
from psfcli.image.result import FieldImage
from psfcli.montecarlo.estimate import Rays, ensquared_energy
from psfcli.montecarlo.exact import ExactRays, clear_radii
from psfcli.montecarlo.third_order import ThirdOrderRays
from psfcli.surface.harvey_shack import horizon, phase_per_height
from psfcli.telescope.system import Field
from psfcli.tolerance import PRESETS
from psfcli.validation.comparison import CENTRES, Comparison

Real = NDArray[np.float64]
Progress = Callable[[int], None]
Convolution = tuple[int, int, FieldImage]
"""The index of a wavelength, that of a field, and their image."""

_PILOT = 300_000
_NEAR_HORIZON = 0.1  # of the smallest d_j: farther out, how the spectrum ends at the horizon shows


class Level(StrEnum):
    """What the rays are: third-order geometry, on which Eq. 44 is exact, or the surfaces of the prescription."""

    THIRD_ORDER = "third-order"
    EXACT = "exact"


def compare(
    system: System,
    level: Level,
    rays: int,
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
    images: Sequence[Convolution] | None = None,
) -> list[Comparison]:
    """Eq. 44 by convolution at ``reference`` against ``rays`` of some ``level``, for every image of a ``system``.

    ``progress`` is called with numbers of rays done; EXACT needs a system with a prescription. Boxes are about the
    chief ray and the centroid that each of the two has itself. ``images`` are the ``convolutions``, where they are
    there already. Raises SceneError where the convolution cannot be computed.
    """
    found = []
    for w, f, image in convolutions(system) if images is None else images:
        wavelength, field, squares = system.wavelengths[w], system.fields[f], image.ensquared
        traced = _rays(system, level, wavelength, field)
        centres = traced.centres() if isinstance(traced, ExactRays) else _centres(image)
        estimate = ensquared_energy(
            traced, squares.half_width, centres, rays, seed=(seed, w, f), jobs=jobs, progress=progress
        )
        found.append(
            Comparison(
                wavelength=wavelength,
                field=field,
                half_width=squares.half_width,
                convolution=np.array([squares.ee, squares.ee_chief, squares.ee_centroid]),
                told=image.reached.ee + end_of_spectrum(system, wavelength, squares.half_width),
                estimate=estimate,
                judged=squares.half_width <= farthest_judged(system),
            )
        )
    return found


def seconds(system: System, level: Level, rays: int, jobs: int) -> float:
    """The time [s] that ``rays`` of each image of a ``system`` take, from a few of the first image's."""
    half_width = np.geomspace(1e-3, 1e3, 100) * system.detector.pixel
    images = len(system.wavelengths) * len(system.fields)
    traced = _rays(system, level, system.wavelengths[0], system.fields[0])
    started = time.perf_counter()
    tried = ensquared_energy(traced, half_width, [(0.0, 0.0)] * len(CENTRES), min(rays, _PILOT), seed=(0,))
    return (time.perf_counter() - started) * rays / tried.rays * images / jobs


def farthest_judged(system: System) -> float:
    """The half width [mm] beyond which boxes are not judged: a tenth of the smallest d_j of a rough surface."""
    distance = [system.telescope.magnified_distance(s.marginal_height) for s in system.surfaces if s.psd]
    return _NEAR_HORIZON * min(distance, default=math.inf)


def end_of_spectrum(system: System, wavelength: float, half_width: Real) -> Real:
    """By how much energies of boxes may differ for the way the spectrum ends at the horizon, shape of ``half_width``.

    Rays draw f < 1/lambda; H is that of the whole spectrum, clipped at 1. They differ for separations near lambda,
    hence near 90 degrees: by less than (C - 1)/4 (w/d_j)^2 of the phase variance beyond the horizon, for w < d_j/10
    (measured; the difference of the two transfer functions, one surface, C from 1.05 to 1.8).
    """
    bound = np.zeros_like(half_width)
    for surface in system.surfaces:
        K, edge = phase_per_height(surface, wavelength), horizon(surface, wavelength)
        relative = half_width / system.telescope.magnified_distance(surface.marginal_height)
        for term in surface.psd:
            beyond = K**2 * term.band_variance(edge, math.inf)
            bound += 0.25 * (term.C - 1.0) * beyond * relative**2
    return np.minimum(bound, 1.0)


def _rays(system: System, level: Level, wavelength: float, field: Field) -> Rays:
    """The rays of one image."""
    if level is Level.THIRD_ORDER:
        return ThirdOrderRays(system.telescope, system.surfaces, wavelength, field)
    assert system.prescription is not None
    pupil = system.telescope.pupil
    clear = clear_radii(system.prescription, system.surfaces, pupil, system.telescope.max_field)
    return ExactRays(system.prescription, system.surfaces, pupil, wavelength, field, clear)


def convolutions(system: System) -> list[Convolution]:
    """Every image at ``reference`` accuracy, in order, energies alone. Raises SceneError where one cannot be computed.

    The energies of an image [box] are fractions of all light (Eq. 44), good to 1e-8.
    """
    scene = recipe.plan(replace(system, tolerance=PRESETS["reference"]), with_cube=False)
    return sorted(recipe.images(scene), key=lambda found: found[:2])


def _centres(image: FieldImage) -> list[tuple[float, float]]:
    """The points that boxes are centred on, as CENTRES [mm]."""
    spot = image.spot
    return [(0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)]
