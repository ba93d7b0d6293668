"""One row of the tradeoff: what was calculated, how wrong it came out, what it took."""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from psfcli.tolerance import Tolerance

Answer = TypeVar("Answer")

_LONG = 1.0  # seconds: what takes longer is timed once


@dataclass(frozen=True, slots=True)
class Measurement:
    """One calculation of the image by ``method`` at a ``setting``: an accuracy, or a size.

    ``true`` errors against the truth, those ``asked`` for and ``estimated`` by the calculation itself (None: the
    method has neither); ``seconds`` of processor time and ``peak_memory`` [MB] beyond what was loaded before.
    ``extrapolated``: not calculated, but told from the method's error law.
    """

    method: str
    setting: str
    true: Tolerance
    seconds: float
    peak_memory: float
    asked: Tolerance | None = None
    estimated: Tolerance | None = None
    extrapolated: bool = False

    @property
    def met(self) -> bool:
        """Whether both errors, true and estimated, are within those asked for."""
        found = [self.true, *([self.estimated] if self.estimated else [])]
        return self.asked is None or all(f.pixel <= self.asked.pixel and f.ee <= self.asked.ee for f in found)


@dataclass(frozen=True, slots=True)
class Timed(Generic[Answer]):
    """The ``answer`` of a calculation with its median time [s] and its peak memory [MB]."""

    answer: Answer
    seconds: float
    peak_memory: float


def timed(task: Callable[[], Answer], repetitions: int) -> Timed[Answer]:
    """Run ``task`` once to warm up and to see its memory, then ``repetitions`` times by the clock; once if it is long.

    Time is the processor's: all methods run on one thread, so that it is the wall time of an idle machine, whatever
    else a busy one does. Memory is what Python and numpy allocate, by tracemalloc.
    """
    tracemalloc.start()
    try:
        started = time.process_time()
        answer = task()
        first = time.process_time() - started
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    seconds = []
    for _ in range(1 if first > _LONG else repetitions):
        started = time.process_time()
        task()
        seconds.append(time.process_time() - started)
    return Timed(answer, statistics.median(seconds), round(1e-6 * peak, 1))
