"""The recipe, as in Section 4 of the paper: plan, scatter once per wavelength, image each field, write the products."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from psfcli.image.point import WavelengthScatter, field_images, wavelength_scatter
from psfcli.planning.plan import Plan, plan_scene
from psfcli.products.arrays import Result, gather
from psfcli.products.header import RunHeader
from psfcli.products.target import FORMATS
from psfcli.products.writer import ProductWriter
from psfcli.surface.mixture import MixtureError
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from concurrent.futures import Future

    from psfcli.config.model import System
    from psfcli.image.result import FieldImage

Progress = Callable[[int, int], None]


def plan(system: System, *, with_cube: bool = True, jobs: int = 1) -> Plan:
    """What the system requires; ``with_cube`` False: ensquared energy alone."""
    return plan_scene(
        system.telescope,
        system.surfaces,
        system.wavelengths,
        system.fields,
        system.detector,
        system.half_widths,
        system.tolerance,
        with_cube=with_cube,
        jobs=jobs,
    )


def images(scene: Plan, jobs: int = 1) -> Iterator[tuple[int, int, FieldImage]]:
    """Yield (wavelength index, field index, image), wavelength after wavelength, fields in order.

    A few fields are computed together, in this process or in one of ``jobs`` that hold no more of them than there are
    processes; with one BLAS thread each, so that the numbers do not depend on ``jobs``.
    """
    count = len(scene.fields)
    parts = [range(f, min(f + scene.together, count)) for f in range(0, count, scene.together)]
    order = [(w, part) for w in range(len(scene.wavelengths)) for part in parts]
    with threadpool_limits(limits=1, user_api="blas"):
        if jobs == 1:
            scatter = None
            for w, part in order:
                if part.start == 0 or scatter is None:
                    scatter = _scatter(scene, w)
                for f, image in zip(part, _images(scene, scatter, part), strict=True):
                    yield w, f, image
            return
        from concurrent.futures import ProcessPoolExecutor  # here, for few runs need them
        from multiprocessing import get_all_start_methods, get_context

        scatters = [_scatter(scene, w) for w in range(len(scene.wavelengths))]
        # forked processes begin with everything loaded and computed so far; elsewhere they load it again
        method = "fork" if "fork" in get_all_start_methods() else "spawn"
        with ProcessPoolExecutor(jobs, get_context(method), _adopt, (scene, scatters)) as pool:
            ahead: deque[Future[list[FieldImage]]] = deque()
            for i, (w, part) in enumerate(order):
                while len(ahead) <= jobs and i + len(ahead) < len(order):
                    ahead.append(pool.submit(_adopted_images, *order[i + len(ahead)]))
                for f, image in zip(part, ahead.popleft().result(), strict=True):
                    yield w, f, image


_adopted: tuple[Plan, list[WavelengthScatter]] | None = None  # what a worker process works on


def _adopt(scene: Plan, scatters: list[WavelengthScatter]) -> None:
    global _adopted
    _adopted = scene, scatters


def _adopted_images(w: int, part: range) -> list[FieldImage]:
    assert _adopted is not None
    scene, scatters = _adopted
    with threadpool_limits(limits=1, user_api="blas"):
        return list(_images(scene, scatters[w], part))


@dataclass(frozen=True, slots=True)
class Trial:
    """One image computed to see what a run would reach and cost; ``gaussians`` is the size of the halo's mixture."""

    field_index: int
    gaussians: int
    image: FieldImage
    seconds: float


def trials(scene: Plan, wavelength_index: int, field_indices: Sequence[int]) -> list[Trial]:
    """The images of a few fields at one wavelength, computed in earnest and thrown away."""
    tried = []
    with threadpool_limits(limits=1, user_api="blas"):
        scatter = _scatter(scene, wavelength_index)
        for index in field_indices:
            started = time.perf_counter()
            (image,) = _images(scene, scatter, [index])
            tried.append(Trial(index, scatter.halo.mixture.weight.size, image, time.perf_counter() - started))
    return tried


def _scatter(scene: Plan, w: int) -> WavelengthScatter:
    try:
        return wavelength_scatter(
            scene.surfaces,
            scene.telescope,
            scene.wavelengths[w],
            scene.half_widths,
            scene.reach,
            scene.tolerance,
        )
    except MixtureError as error:
        raise SceneError(f"at {1e6 * scene.wavelengths[w]:.6g} nm: {error}") from error


def _images(scene: Plan, scatter: WavelengthScatter, field_indices: Sequence[int]) -> Iterator[FieldImage]:
    return field_images(
        scene.telescope,
        [scene.fields[index] for index in field_indices],
        scatter,
        scene.detector,
        scene.tolerance,
        with_cube=scene.with_cube,
    )


def header(
    system: System, scene: Plan, *, command: str = "", input_name: str = "", input_sha256: str = ""
) -> RunHeader:
    """What the products say of a run besides its images."""
    return RunHeader(
        title=system.title,
        wavelengths=scene.wavelengths,
        specular_fractions=scene.specular_fractions,
        throughput=math.prod(surface.reflectance for surface in scene.surfaces),
        telescope=scene.telescope,
        surfaces=tuple(row for rows in scene.scatter for row in rows),
        fields=scene.fields,
        detector=scene.detector,
        tolerance=scene.tolerance,
        config=system.text,
        command=command,
        input_name=input_name,
        input_sha256=input_sha256,
        plan=scene.report(),
    )


def run(system: System, jobs: int = 1) -> Result:
    """The system's images and tables in memory."""
    scene = plan(system, jobs=jobs)
    return gather(header(system, scene), images(scene, jobs))


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run left: the files written, remarks for the user, the worst errors reached, and the time it took [s]."""

    paths: tuple[Path, ...]
    notes: tuple[str, ...]
    reached: Tolerance
    seconds: float


def write(
    system: System,
    directory: str | Path,
    *,
    formats: Sequence[str] = FORMATS,
    overwrite: bool = False,
    jobs: int = 1,
    max_memory: float = math.inf,
    command: str = "",
    input_name: str = "",
    input_sha256: str = "",
    progress: Progress | None = None,
) -> Outcome:
    """Compute the system and write its products into ``directory``; ``progress(done, total)`` is called per image.

    Raises OutputError when the products cannot be written, SceneError when they need more than ``max_memory`` bytes.
    """
    started = time.perf_counter()
    scene = plan(system, with_cube=formats_with_cube(formats), jobs=jobs)
    if scene.memory > max_memory:
        raise SceneError(
            f"the run needs {1e-6 * scene.memory:.0f} MB of memory and may use {1e-6 * max_memory:.0f} MB; "
            "fewer pixels, a smaller oversample, fewer jobs or a larger --max-memory would do"
        )
    worst = Tolerance(0.0, 0.0)
    total = len(scene.wavelengths) * len(scene.fields)
    about = header(system, scene, command=command, input_name=input_name, input_sha256=input_sha256)
    with ProductWriter(Path(directory), about, formats, overwrite=overwrite) as products:
        for done, (w, f, image) in enumerate(images(scene, jobs), start=1):
            products.add(w, f, image)
            worst = Tolerance(max(worst.pixel, image.reached.pixel), max(worst.ee, image.reached.ee))
            if progress is not None:
                progress(done, total)
        seconds = time.perf_counter() - started
        products.timings = {"seconds": seconds}
    return Outcome(products.paths, (*scene.warnings, *products.notes), worst, seconds)


def formats_with_cube(formats: Sequence[str]) -> bool:
    """Whether any of the ``formats`` holds pixels."""
    return bool({"fits", "exr"} & set(formats))


class SceneError(Exception):
    """A scene that cannot be computed, for want of memory or of a method; the message is one line for the user."""
