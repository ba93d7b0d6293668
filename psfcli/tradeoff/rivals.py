"""What one would do otherwise: plain FFT, Monte Carlo, rays counted without scatter; each at several sizes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from psfcli.image.result import FieldImage
from psfcli.planning.plan import Plan
from psfcli.tolerance import Tolerance
from psfcli.tradeoff.errors import expected_pixel_error, rival_error
from psfcli.tradeoff.measurement import Measurement, timed
from psfcli.tradeoff.plain_fft import plain_fft, plain_fft_memory
from psfcli.tradeoff.rays import counted, pupil_grid, scattered_rays

Real = NDArray[np.float64]
Progress = Callable[[str], None]

FFT, MONTE_CARLO, RAYS = "plain FFT", "Monte Carlo", "rays, no scatter"

_FFT_SIZES = 4
_LARGEST_FFT = 8192
_RAY_COUNTS = 10**4, 10**5, 10**6, 10**7
_EXTRAPOLATED_COUNT = 10**9


@dataclass(frozen=True, slots=True)
class Limits:
    """What one calculation of a rival may take, in seconds and bytes, and how often it is timed."""

    seconds: float
    memory: float
    repetitions: int


@dataclass(frozen=True, slots=True)
class Rival:
    """A method, its sizes from small to large, the power of it that its time goes with, and its bytes at a size."""

    method: str
    sizes: Sequence[int]
    compute: Callable[[Plan, int], tuple[Real, Real]]
    name: Callable[[int], str]
    time_power: float
    memory: Callable[[int], float]


def rivals(scene: Plan) -> list[Rival]:
    """The rivals that make sense in a scene: where nothing scatters, there is nothing to convolve."""
    smallest = max(256, 1 << (2 * scene.detector.sub_pixels - 1).bit_length())
    sizes = [smallest << i for i in range(_FFT_SIZES) if i == 0 or smallest << i <= _LARGEST_FFT]
    grids = [math.isqrt(count) ** 2 for count in _RAY_COUNTS[::2]]
    convolved = Rival(FFT, sizes, plain_fft, lambda size: f"{size} x {size}", 2.0, plain_fft_memory)
    return [
        *([convolved] if scene.specular_fractions[0] < 1.0 else []),
        Rival(MONTE_CARLO, _RAY_COUNTS, _monte_carlo, _rays, 1.0, lambda _: 0.0),
        Rival(RAYS, grids, _without_scatter, _rays, 1.0, lambda _: 0.0),
    ]


def measured_rivals(scene: Plan, truth: FieldImage, limits: Limits, progress: Progress) -> Iterator[Measurement]:
    """The rivals measured against the ``truth``, each up to the size whose cost is expected to pass the ``limits``.

    The time expected of a size is that of the one before, grown by the method's power.
    """
    for rival in rivals(scene):
        found: list[tuple[int, Measurement]] = []
        for size in rival.sizes:
            if not _affordable(rival, size, found, limits):
                progress(f"{rival.method}, {rival.name(size)}: skipped, beyond the limits of time or memory")
                break
            progress(f"{rival.method}, {rival.name(size)}")
            run = timed(partial(rival.compute, scene, size), limits.repetitions)
            error = rival_error(*run.answer, truth, scene)
            measurement = Measurement(rival.method, rival.name(size), error, run.seconds, run.peak_memory)
            found.append((size, measurement))
            yield measurement
        if found and rival.method == MONTE_CARLO:
            yield _extrapolated(found, truth, scene)


def _monte_carlo(scene: Plan, count: int) -> tuple[Real, Real]:
    return counted(scattered_rays(scene, count), scene.detector, scene.half_widths)


def _without_scatter(scene: Plan, count: int) -> tuple[Real, Real]:
    return counted(pupil_grid(scene, count), scene.detector, scene.half_widths)


def _rays(count: int) -> str:
    return f"1e{math.log10(count):.0f} rays"


def _affordable(rival: Rival, size: int, found: Sequence[tuple[int, Measurement]], limits: Limits) -> bool:
    seconds = found[-1][1].seconds * (size / found[-1][0]) ** rival.time_power if found else 0.0
    return seconds <= limits.seconds and rival.memory(size) <= limits.memory


def _extrapolated(found: Sequence[tuple[int, Measurement]], truth: FieldImage, scene: Plan) -> Measurement:
    """Monte Carlo at a count that takes too long: errors go with 1/sqrt(count), time with the count.

    The error of a pixel is the one expected of the binomial law; that of the energies the root mean square of those
    found, each scaled by the law.
    """
    count, last = found[-1]
    ee = math.sqrt(sum(m.true.ee**2 * size for size, m in found) / len(found) / _EXTRAPOLATED_COUNT)
    return replace(
        last,
        setting=_rays(_EXTRAPOLATED_COUNT),
        true=Tolerance(expected_pixel_error(_EXTRAPOLATED_COUNT, truth, scene.detector), ee),
        seconds=last.seconds * _EXTRAPOLATED_COUNT / count,
        extrapolated=True,
    )
