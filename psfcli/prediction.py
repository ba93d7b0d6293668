"""What a run would reach and take, from a few of its images computed in earnest and thrown away."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from psfcli.image.result import FieldImage
from psfcli.planning.plan import Plan
from psfcli.recipe import as_asked_for, computed, scatter_at
from psfcli.tolerance import Tolerance

MOST_TRIALS = 5
"""Images tried at a wavelength."""


@dataclass(frozen=True, slots=True)
class Trial:
    """An image tried, by the index of its field, and the time it took [s]."""

    field_index: int
    image: FieldImage
    seconds: float


@dataclass(frozen=True, slots=True)
class Trials:
    """The images tried at one wavelength, none where it has those of another.

    ``gaussians`` is the size of the halo's mixture, ``scatter_seconds`` the time it took, ``computations`` how many
    images a run computes.
    """

    tried: tuple[Trial, ...]
    gaussians: int
    scatter_seconds: float
    computations: int

    @property
    def seconds(self) -> float:
        """The time [s] all images of the wavelength take in one process."""
        return self.computations * sum(trial.seconds for trial in self.tried) / max(len(self.tried), 1)


def trials(scene: Plan, wavelength_index: int) -> Trials:
    """Some of the images computed at a wavelength, the first and the last among them."""
    own = [c for c in scene.computations if c.wavelength_index == wavelength_index]
    if not own:
        return Trials((), 0, 0.0, 0)
    chosen = sorted({round(i * (len(own) - 1) / (MOST_TRIALS - 1)) for i in range(MOST_TRIALS)})
    with threadpool_limits(limits=1, user_api="blas"):
        started = time.perf_counter()
        scatter = scatter_at(scene, wavelength_index)
        scatter_seconds = time.perf_counter() - started
        tried = []
        for index in chosen:
            started = time.perf_counter()
            (image,) = computed(scene, scatter, [own[index]])
            seconds = time.perf_counter() - started
            _, field_index, made = next(as_asked_for(scene, own[index], image))
            tried.append(Trial(field_index, made, seconds))
    return Trials(tuple(tried), scatter.halo.mixture.weight.size, scatter_seconds, len(own))


def worst(every: Sequence[Trials]) -> Tolerance:
    """The largest errors reached by the images tried."""
    reached = [trial.image.reached for trials in every for trial in trials.tried]
    return Tolerance(max(r.pixel for r in reached), max(r.ee for r in reached))


def seconds(scene: Plan, every: Sequence[Trials]) -> float:
    """The time [s] a run takes beyond start-up and writing: the scatter in one process, the images in all."""
    return sum(t.scatter_seconds for t in every) + sum(t.seconds for t in every) / scene.resources.jobs
