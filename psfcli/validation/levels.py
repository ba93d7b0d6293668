"""The two levels of a validation: rays of third-order geometry, which test the numerics, and exact rays (the model)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from psfcli import recipe
from psfcli.config.model import System
from psfcli.image.result import FieldImage
from psfcli.montecarlo.estimate import Rays, ensquared_energy
from psfcli.montecarlo.third_order import ThirdOrderRays
from psfcli.tolerance import PRESETS
from psfcli.validation.comparison import CENTRES, Comparison

Real = NDArray[np.float64]
Progress = Callable[[int], None]

_PILOT = 300_000
_NEAR_HORIZON = 0.1  # of the smallest d_j: farther out, how the spectrum ends at the horizon shows


def third_order(
    system: System, rays: int, *, seed: int = 0, jobs: int = 1, progress: Progress | None = None
) -> list[Comparison]:
    """Eq. 44 by convolution at ``reference`` against ``rays`` of third-order geometry, for every image of a ``system``.

    ``progress`` is called with numbers of rays done. Raises SceneError where the convolution cannot be computed.
    """
    found = []
    for w, f, image in _convolutions(system):
        squares = image.ensquared
        estimate = ensquared_energy(
            _rays(system, w, f),
            squares.half_width,
            _centres(image),
            rays,
            seed=(seed, w, f),
            jobs=jobs,
            progress=progress,
        )
        found.append(
            Comparison(
                wavelength=system.wavelengths[w],
                field=system.fields[f],
                half_width=squares.half_width,
                convolution=np.array([squares.ee, squares.ee_chief, squares.ee_centroid]),
                told=image.reached.ee,
                estimate=estimate,
                judged=squares.half_width <= farthest_judged(system),
            )
        )
    return found


def seconds(system: System, rays: int, jobs: int) -> float:
    """The time [s] that ``rays`` of each image of a ``system`` take, from a few of the first image's."""
    half_width = np.geomspace(1e-3, 1e3, 100) * system.detector.pixel
    images = len(system.wavelengths) * len(system.fields)
    started = time.perf_counter()
    tried = ensquared_energy(_rays(system, 0, 0), half_width, [(0.0, 0.0)] * len(CENTRES), _PILOT, seed=(0,))
    return (time.perf_counter() - started) * rays / tried.rays * images / jobs


def _rays(system: System, w: int, f: int) -> Rays:
    """The rays of one image."""
    return ThirdOrderRays(system.telescope, system.surfaces, system.wavelengths[w], system.fields[f])


def farthest_judged(system: System) -> float:
    """The half width [mm] beyond which boxes are not judged: a tenth of the smallest d_j of a rough surface.

    The rays draw f < 1/lambda, while H is that of the whole spectrum clipped at 1: twice scattered light differs, and
    light near 90 degrees, relative to all light at r as (r/d_j)^(C+1).
    """
    distance = [system.telescope.magnified_distance(s.marginal_height) for s in system.surfaces if s.psd]
    return _NEAR_HORIZON * min(distance, default=math.inf)


def _convolutions(system: System) -> list[tuple[int, int, FieldImage]]:
    """(wavelength index, field index, image) of every image at ``reference`` accuracy, without pixels, in order."""
    scene = recipe.plan(replace(system, tolerance=PRESETS["reference"]), with_cube=False)
    return sorted(recipe.images(scene), key=lambda found: found[:2])


def _centres(image: FieldImage) -> list[tuple[float, float]]:
    """The points that boxes are centred on, as CENTRES [mm]."""
    spot = image.spot
    return [(0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)]
