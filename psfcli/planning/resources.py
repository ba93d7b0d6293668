"""What a run takes: processes, memory, room on the disk."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

from psfcli.image.grid import Detector

_BYTES = 8
_TOGETHER = 8  # fields computed at a time: more gain nothing
_PIXELS_TOGETHER = 1_000_000  # of all fields computed at a time
_WORTH_A_POOL = 24  # images: fewer are done before processes have started
_PROCESS = 150e6  # the interpreter, its libraries, rays and tables of a scene
_WORKER = 60e6  # what a process forked from it takes besides
_COPIES = 3  # of an image being made: itself, a product of matrices before it is added, a twin or a plane for a file
_PER_IMAGE = 2500.0  # bytes kept of each image's spot and errors, and of each of its squares
_PER_SQUARE = 200.0


@dataclass(frozen=True, slots=True)
class Resources:
    """``jobs`` processes, ``together`` fields at a time in each; ``memory`` and ``output`` in bytes."""

    jobs: int
    together: int
    memory: float
    output: float


def resources(
    detector: Detector | None,
    boxes: int,
    images: int,
    computations: int,
    jobs: int | None,
    most: float,
) -> Resources:
    """What ``computations`` that give ``images`` take, in as many ``jobs`` as asked for (None: as many as pay).

    Fewer fields at a time, then fewer jobs, where more would take more than ``most`` bytes; ``memory`` may exceed it
    even so. ``detector`` None: no pixels; ``boxes`` squares for each image.
    """
    values = 0 if detector is None else sum((detector.pixels * scale) ** 2 for scale in {1, detector.oversample})
    plane = _BYTES * values
    most_together = max(1, min(_TOGETHER, _PIXELS_TOGETHER // max(values, 1)))
    if jobs is None:
        jobs = (os.cpu_count() or 1) if computations > _WORTH_A_POOL else 1
    jobs = max(1, min(jobs, computations))
    together = min(most_together, math.ceil(computations / jobs))
    kept = images * (_PER_IMAGE + boxes * _PER_SQUARE)

    def memory(jobs: int, together: int) -> float:
        alone = _PROCESS + kept + _COPIES * plane
        if jobs == 1:
            return alone
        # a worker hands on all it computes together, and as many wait here as there are two of for each, and one more
        return alone + (2 * jobs + 1) * together * plane + jobs * (_WORKER + (_COPIES - 1 + together) * plane)

    while memory(jobs, together) > most and jobs > 1:
        together, jobs = (together // 2, jobs) if together > 1 else (together, jobs - 1)
    together = together if jobs > 1 else most_together  # alone, they are handed on one by one
    return Resources(jobs, together, memory(jobs, together), float(plane * images))
