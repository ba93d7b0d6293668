"""Ensquared energy by counting rays, and how far it can be off."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from psfcli.montecarlo.pupil import FAN
from psfcli.montecarlo.squares import NestedSquares

if TYPE_CHECKING:
    from concurrent.futures import Future

Real = NDArray[np.float64]
Whole = NDArray[np.int64]
T = TypeVar("T")

BATCHES = 128
"""Independent parts of an estimate, by whose scatter its standard error is known to 6 %."""


class Rays(Protocol):
    """What gives landing points: ThirdOrderRays, ExactRays."""

    def landings(self, generator: np.random.Generator, count: int) -> Iterator[tuple[Real, Real]]:
        """Landing points (x, y) [mm] of ``count`` rays, in blocks; what is lost lies at infinity."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Energies of squares about some centres as fractions of all ``rays``, and their standard errors: [centre, box].

    ``lost`` is the fraction of the rays that never reach the image plane.
    """

    energy: Real
    standard_error: Real
    rays: int
    lost: float


def ensquared_energy(
    rays: Rays,
    half_width: Real,
    centres: Sequence[tuple[float, float]],
    count: int,
    *,
    seed: tuple[int, ...],
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Estimate:
    """Energies in squares of increasing ``half_width`` [mm] about ``centres`` [mm], by ``count`` rays or a few more.

    Standard errors are those of the mean of BATCHES batches, each with a quasi-random shift and a seed of its own made
    from ``seed``: they hold whatever the rays of a batch have in common. At least 1/rays. The same numbers for the same
    seed by any number of ``jobs``; ``progress`` is called with the rays of each batch done.
    """
    size = batch_size(count)
    inside = np.zeros((len(centres), half_width.size), dtype=np.int64)
    squares = np.zeros_like(inside, dtype=np.float64)
    lost = 0
    batch = partial(_batch, rays, NestedSquares(half_width), tuple(centres), size, seed)
    for counts, gone in batches(batch, jobs):
        inside += counts
        squares += (counts / size) ** 2
        lost += gone
        if progress is not None:
            progress(size)
    energy = inside / (size * BATCHES)
    variance = np.maximum(squares / BATCHES - energy**2, 0.0) / (BATCHES - 1)
    all_rays = size * BATCHES
    return Estimate(energy, np.maximum(np.sqrt(variance), 1.0 / all_rays), all_rays, lost / all_rays)


def _batch(
    rays: Rays,
    squares: NestedSquares,
    centres: tuple[tuple[float, float], ...],
    size: int,
    seed: tuple[int, ...],
    number: int,
) -> tuple[Whole, int]:
    """The rays of one batch inside each square, shape [centre, box], and how many are lost."""
    counts, lost = np.zeros(1, dtype=np.int64), 0
    for x, y in rays.landings(chance(seed, number), size):
        counts = counts + np.array([squares.inside(x, y, centre) for centre in centres])
        lost += int(np.count_nonzero(np.isinf(x)))
    return counts, lost


def batch_size(count: int) -> int:
    """The rays of each of BATCHES batches, whole fans, that are ``count`` together or a few more."""
    return FAN * math.ceil(count / (FAN * BATCHES))


def chance(seed: tuple[int, ...], number: int) -> np.random.Generator:
    """The generator of one batch."""
    return np.random.default_rng(np.random.SeedSequence(seed[0], spawn_key=(*seed[1:], number)))


def batches(batch: Callable[[int], T], jobs: int) -> Iterator[T]:
    """What ``batch`` gives for each number below BATCHES, in order, by this process or by several."""
    if jobs == 1:
        yield from map(batch, range(BATCHES))
        return
    from concurrent.futures import ProcessPoolExecutor  # here, for one process needs none
    from multiprocessing import get_all_start_methods, get_context

    method = "fork" if "fork" in get_all_start_methods() else "spawn"
    with ProcessPoolExecutor(jobs, get_context(method)) as pool:
        ahead: deque[Future[T]] = deque()
        for number in range(BATCHES):
            while len(ahead) <= jobs and number + len(ahead) < BATCHES:
                ahead.append(pool.submit(batch, number + len(ahead)))
            yield ahead.popleft().result()
