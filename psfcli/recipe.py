"""The recipe, as in Section 4 of the paper: plan, scatter once per wavelength, image each field, write the products."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from psfcli.image.geometric import spots
from psfcli.image.point import WavelengthScatter, field_images, wavelength_scatter
from psfcli.planning.plan import Plan, plan_scene
from psfcli.planning.sharing import Computation
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


def plan(
    system: System,
    *,
    with_cube: bool = True,
    with_boxes: bool = True,
    jobs: int | None = 1,
    max_memory: float = math.inf,
    everything: bool = False,
) -> Plan:
    """What the system requires; ``with_cube`` False: ensquared energy alone, ``with_boxes`` False: pixels alone.

    ``jobs`` None: as many as pay. ``everything`` skips no effect, however little it changes. Raises AccuracyUnreachable
    when no way to compute it takes ``max_memory`` bytes or less, SceneError when pixels lie where no light lands.
    """
    scene = plan_scene(
        system.telescope,
        system.surfaces,
        system.wavelengths,
        system.fields,
        system.detector,
        system.half_widths,
        system.tolerance,
        with_cube=with_cube,
        with_boxes=with_boxes,
        jobs=jobs,
        max_memory=max_memory,
        everything=everything,
        prescription=system.prescription,
    )
    if with_cube and system.detector.farthest() > scene.lit_to:
        raise SceneError(
            f"the window reaches {system.detector.farthest():.4g} mm from the image point, and no light lands beyond "
            f"{scene.lit_to:.4g} mm, far outside the small angles of Eq. 36; fewer or smaller pixels or --format csv "
            "would do"
        )
    if scene.resources.memory > max_memory:
        raise AccuracyUnreachable(
            f"the accuracy asked for cannot be met: a field at a time in one process takes "
            f"{1e-6 * scene.resources.memory:.0f} MB of memory, {1e-6 * max_memory:.0f} MB are allowed; reached is "
            "nothing, no product is written; fewer pixels, a smaller oversample, --format csv or a larger --max-memory "
            "would do"
        )
    return scene


def plan_of_products(system: System, formats: Sequence[str], *, jobs: int | None, max_memory: float) -> Plan:
    """What products of some ``formats`` require of the system; nothing that none of them holds."""
    with_boxes = bool({"fits", "csv"} & set(formats))
    return plan(system, with_cube=formats_with_cube(formats), with_boxes=with_boxes, jobs=jobs, max_memory=max_memory)


def images(scene: Plan) -> Iterator[tuple[int, int, FieldImage]]:
    """Yield (wavelength index, field index, image), each image followed by those that are the same but for a turn.

    A few fields are computed together, in this process or in one of several that hold no more of them than there are
    processes; with one BLAS thread each, so that the numbers do not depend on how many there are.
    """
    parts = list(_parts(scene))
    with threadpool_limits(limits=1, user_api="blas"):
        if scene.resources.jobs == 1:
            scatter, of = None, -1
            for part in parts:
                if part[0].wavelength_index != of:
                    of = part[0].wavelength_index
                    scatter = scatter_at(scene, of)
                assert scatter is not None
                for computation, image in zip(part, computed(scene, scatter, part), strict=True):
                    yield from as_asked_for(scene, computation, image)
            return
        from concurrent.futures import ProcessPoolExecutor  # here, for few runs need them
        from multiprocessing import get_all_start_methods, get_context

        jobs = scene.resources.jobs
        scatters = {w: scatter_at(scene, w) for w in dict.fromkeys(part[0].wavelength_index for part in parts)}
        # forked processes begin with everything loaded and computed so far; elsewhere they load it again
        method = "fork" if "fork" in get_all_start_methods() else "spawn"
        with ProcessPoolExecutor(jobs, get_context(method), _adopt, (scene, scatters)) as pool:
            ahead: deque[Future[list[FieldImage]]] = deque()
            for i, part in enumerate(parts):
                # two for each and one: none waits for work while the images of the one before are taken
                while len(ahead) <= 2 * jobs and i + len(ahead) < len(parts):
                    ahead.append(pool.submit(_adopted_images, parts[i + len(ahead)]))
                for computation, image in zip(part, ahead.popleft().result(), strict=True):
                    yield from as_asked_for(scene, computation, image)


def _parts(scene: Plan) -> Iterator[Sequence[Computation]]:
    """The computations of one wavelength, a few at a time, then those of the next.

    Processes take half as many at a time towards the end, so that none has long to wait for the last.
    """
    jobs, most = scene.resources.jobs, scene.resources.together
    for _, same in groupby(scene.computations, key=lambda computation: computation.wavelength_index):
        left = list(same)
        while left:
            few = (
                most
                if jobs == 1
                else min(max(len(left) // (2 * jobs), (most + 1) // 2), math.ceil(len(left) / jobs), most)
            )
            yield left[:few]
            del left[:few]


def as_asked_for(scene: Plan, computation: Computation, image: FieldImage) -> Iterator[tuple[int, int, FieldImage]]:
    """The images that one computed stands for, with what all skipped effects change among the errors reached."""
    for twin in computation.stands_for:
        left_out, made = scene.left_out[twin.wavelength_index], twin.symmetry.image(image)
        if scene.modelled_telescope != scene.telescope:
            (spot,) = spots(scene.telescope, [scene.fields[twin.field_index]])
            made = replace(made, spot=spot)
        reached = Tolerance(made.reached.pixel + left_out.pixel, made.reached.ee + left_out.ee)
        yield twin.wavelength_index, twin.field_index, replace(made, reached=reached)


_adopted: tuple[Plan, dict[int, WavelengthScatter]] | None = None  # what a worker process works on


def _adopt(scene: Plan, scatters: dict[int, WavelengthScatter]) -> None:
    global _adopted
    _adopted = scene, scatters
    threadpool_limits(limits=1, user_api="blas")  # for as long as the process lives


def _adopted_images(part: Sequence[Computation]) -> list[FieldImage]:
    assert _adopted is not None
    scene, scatters = _adopted
    return list(computed(scene, scatters[part[0].wavelength_index], part))


def scatter_at(scene: Plan, w: int) -> WavelengthScatter:
    """What all fields at a wavelength share; raises SceneError where no mixture holds it."""
    try:
        return wavelength_scatter(
            scene.modelled_surfaces[w],
            scene.modelled_telescope,
            scene.wavelengths[w],
            scene.half_widths,
            scene.reach,
            scene.tolerance,
            with_cube=scene.with_cube,
        )
    except MixtureError as error:
        raise SceneError(f"at {1e6 * scene.wavelengths[w]:.6g} nm: {error}") from error


def computed(scene: Plan, scatter: WavelengthScatter, computations: Sequence[Computation]) -> Iterator[FieldImage]:
    """The images of some computations, all of one wavelength."""
    return field_images(
        scene.modelled_telescope,
        [computation.field for computation in computations],
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
        warnings=scene.warnings,
    )


def run(system: System, jobs: int | None = 1) -> Result:
    """The system's images and tables in memory, by ``jobs`` processes (None: as many as pay)."""
    scene = plan(system, jobs=jobs)
    return gather(header(system, scene), images(scene))


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run left: the files written, remarks for the user, the worst errors reached, processes and time [s]."""

    paths: tuple[Path, ...]
    notes: tuple[str, ...]
    reached: Tolerance
    jobs: int
    seconds: float


def write(
    system: System,
    directory: str | Path,
    *,
    formats: Sequence[str] = FORMATS,
    overwrite: bool = False,
    jobs: int | None = 1,
    max_memory: float = math.inf,
    command: str = "",
    input_name: str = "",
    input_sha256: str = "",
    progress: Progress | None = None,
) -> Outcome:
    """Compute the system and write its products into ``directory``; ``progress(done, total)`` is called per image.

    ``formats`` are some of FORMATS, ``jobs`` processes (None: as many as pay; fewer where ``max_memory`` [byte] is
    little). Raises OutputError when the products cannot be written, SceneError when they cannot be computed.
    """
    started = time.perf_counter()
    if isinstance(formats, str) or not set(formats) <= set(FORMATS):
        raise ValueError(f"formats: {formats!r} is no list of some of {', '.join(FORMATS)}")
    scene = plan_of_products(system, formats, jobs=jobs, max_memory=max_memory)
    worst = Tolerance(0.0, 0.0)
    total = len(scene.wavelengths) * len(scene.fields)
    about = header(system, scene, command=command, input_name=input_name, input_sha256=input_sha256)
    with ProductWriter(Path(directory), about, formats, overwrite=overwrite) as products:
        for done, (w, f, image) in enumerate(images(scene), start=1):
            products.add(w, f, image)
            worst = Tolerance(max(worst.pixel, image.reached.pixel), max(worst.ee, image.reached.ee))
            if progress is not None:
                progress(done, total)
        seconds = time.perf_counter() - started
        products.timings = {"seconds": seconds}
    return Outcome(products.paths, (*scene.warnings, *products.notes), worst, scene.resources.jobs, seconds)


def formats_with_cube(formats: Sequence[str]) -> bool:
    """Whether any of the ``formats`` holds pixels."""
    return bool({"fits", "exr"} & set(formats))


class SceneError(Exception):
    """A scene that cannot be computed, for want of memory or of a method; the message is one line for the user."""


class AccuracyUnreachable(SceneError):
    """A scene that cannot be computed as accurately as asked for within the memory allowed."""
