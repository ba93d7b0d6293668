"""What a scene requires, decided in one place before anything is computed: effects, distances, images, resources."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.image.ensquared import default_half_widths
from psfcli.image.grid import Detector
from psfcli.image.result import SurfaceScatter
from psfcli.image.scatter import scatter_table
from psfcli.planning.displacement import displacements, sensitivity
from psfcli.planning.effects import (
    Effect,
    aberration_effects,
    grid_effects,
    image_effects,
    reach_effects,
    scatter_effects,
)
from psfcli.planning.resources import Resources, resources
from psfcli.planning.sharing import Computation, each_by_itself, shared_computations
from psfcli.planning.smoothness import Smoothness, smooth_enough
from psfcli.surface.surface import Surface
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

SHARE = 0.05
"""Of the accuracy asked for, what all skipped scatter may take, and as much all skipped aberrations."""

_HORIZONS = 9.0  # d_j: light goes no farther, but for ripples of the clip that nobody needs


@dataclass(frozen=True, slots=True)
class Plan:
    """A scene and what it takes.

    ``telescope``, ``surfaces`` and ``fields`` are as asked for. ``modelled_telescope`` has the aberrations that matter,
    ``modelled_surfaces``, one row per wavelength, the PSD terms that do; ``left_out``, one per wavelength, bounds what
    all the rest changes. ``computations`` are the images computed, each with those it stands for; ``effects`` tells all
    this in words.

    ``reach`` [mm] is the farthest distance from the image point that anything asks for, or ``lit_to``, beyond which no
    light lands; ``half_widths`` [mm] the boxes, increasing, none where no product holds them; ``scatter`` one row of
    surfaces and ``specular_fractions`` one number per wavelength; ``warnings`` one line each.
    """

    telescope: Telescope
    surfaces: tuple[Surface, ...]
    wavelengths: tuple[float, ...]
    fields: tuple[Field, ...]
    detector: Detector
    tolerance: Tolerance
    with_cube: bool
    half_widths: Real
    reach: float
    lit_to: float
    scatter: tuple[tuple[SurfaceScatter, ...], ...]
    specular_fractions: tuple[float, ...]
    modelled_telescope: Telescope
    modelled_surfaces: tuple[tuple[Surface, ...], ...]
    left_out: tuple[Tolerance, ...]
    computations: tuple[Computation, ...]
    resources: Resources
    effects: tuple[Effect, ...]
    warnings: tuple[str, ...]

    def report(self) -> dict[str, object]:
        """The plan in plain numbers, as JSON holds them: mm, bytes, fractions of all light."""
        return {
            "asked": {"pixel": self.tolerance.pixel, "ee": self.tolerance.ee},
            "images": len(self.wavelengths) * len(self.fields),
            "computed": len(self.computations),
            "grid": self.detector.sub_pixels if self.with_cube else 0,
            "boxes": int(self.half_widths.size),
            "reach_mm": self.reach,
            "specular_fraction": list(self.specular_fractions),
            "jobs": self.resources.jobs,
            "memory_bytes": self.resources.memory,
            "output_bytes": self.resources.output,
            "effects": [effect.report() for effect in self.effects],
            "warnings": list(self.warnings),
        }


def plan_scene(
    telescope: Telescope,
    surfaces: Sequence[Surface],
    wavelengths: Sequence[float],
    fields: Sequence[Field],
    detector: Detector,
    half_widths: Sequence[float] | None,
    tolerance: Tolerance,
    *,
    with_cube: bool = True,
    with_boxes: bool = True,
    jobs: int | None = 1,
    max_memory: float = math.inf,
    everything: bool = False,
) -> Plan:
    """The plan of a scene; ``half_widths`` [mm] None: the default boxes, within the horizon.

    ``jobs`` None: as many as pay; ``max_memory`` [byte] may take some of them. ``everything``: nothing is skipped or
    shared but what no product asked for holds, to see what skipping changes.
    """
    boxes = default_half_widths(detector.pixel, detector.pixels) if half_widths is None else np.sort(half_widths)
    boxes = boxes if with_boxes else boxes[:0]
    sizes = displacements(telescope, fields)
    farthest = sum(sizes.values())
    scatter = tuple(scatter_table(surfaces, telescope, wavelength) for wavelength in wavelengths)
    specular_fractions = tuple(math.exp(-sum(row.g for row in rows)) for rows in scatter)
    share = 0.0 if everything else SHARE
    allowed = Tolerance(share * tolerance.pixel, share * tolerance.ee)
    pixels_to = detector.farthest() + 2.0 * farthest if with_cube else 0.0
    smooth = tuple(smooth_enough(surfaces, telescope, wavelength, pixels_to, allowed) for wavelength in wavelengths)
    asked = max(math.sqrt(2.0) * float(boxes.max(initial=0.0)), detector.farthest() if with_cube else 0.0)
    lit_to = _lit_to(telescope, [surface for each in smooth for surface in each.surfaces])
    reach = min(asked + 2.0 * farthest, lit_to)
    worth = sensitivity(
        {wavelength: each.surfaces for wavelength, each in zip(wavelengths, smooth, strict=True)},
        telescope,
        max(specular_fractions),
        detector if with_cube else None,
        float(boxes.min(initial=math.inf)),
    )
    displaced = worth.change(farthest) if farthest else Tolerance(0.0, 0.0)
    unaberrated = not everything and displaced.pixel <= allowed.pixel and displaced.ee <= allowed.ee
    modelled = replace(telescope, seidel=SeidelTable()) if unaberrated else telescope
    smallest = min(float(boxes.min(initial=math.inf)), detector.sub_pixel if with_cube else math.inf)
    shifted = displaced if unaberrated else Tolerance(0.0, 0.0)
    rough = [each.scatters for each in smooth]
    computations = (
        each_by_itself(fields, len(wavelengths))
        if everything
        else shared_computations(modelled, fields, rough, detector if with_cube else None)
    )
    return Plan(
        telescope=telescope,
        surfaces=tuple(surfaces),
        wavelengths=tuple(wavelengths),
        fields=tuple(fields),
        detector=detector,
        tolerance=tolerance,
        with_cube=with_cube,
        half_widths=boxes,
        reach=reach,
        lit_to=lit_to,
        scatter=scatter,
        specular_fractions=specular_fractions,
        modelled_telescope=modelled,
        modelled_surfaces=tuple(each.surfaces for each in smooth),
        left_out=tuple(
            Tolerance(each.left_out.pixel + shifted.pixel, each.left_out.ee + shifted.ee) for each in smooth
        ),
        computations=computations,
        resources=resources(
            detector if with_cube else None,
            int(boxes.size),
            len(wavelengths) * len(fields),
            len(computations),
            jobs,
            max_memory,
        ),
        effects=(
            *_scatter_effects(surfaces, telescope, wavelengths, smooth),
            *_reach_effects(smooth, telescope, wavelengths, reach, smallest, tolerance),
            *aberration_effects(sizes, worth, modelled=modelled.seidel != SeidelTable()),
            *image_effects(computations, _field_names(telescope, fields), _wavelength_names(wavelengths)),
            *grid_effects(detector, with_cube=with_cube, boxes=int(boxes.size), distance=reach),
        ),
        warnings=tuple(_remarks(telescope, surfaces, reach)),
    )


def _lit_to(telescope: Telescope, surfaces: Sequence[Surface]) -> float:
    """The distance [mm] beyond the horizons of all ``surfaces`` that scatter within which light lands; inf if none."""
    distances = (telescope.magnified_distance(surface.marginal_height) for surface in surfaces if surface.psd)
    return _HORIZONS * max(distances, default=math.inf)


def _scatter_effects(
    surfaces: Sequence[Surface], telescope: Telescope, wavelengths: Sequence[float], smooth: Sequence[Smoothness]
) -> Iterator[Effect]:
    for name, wavelength, smoothness in zip(_places(wavelengths), wavelengths, smooth, strict=True):
        yield from scatter_effects(surfaces, telescope, wavelength, smoothness, name)


def _reach_effects(
    smooth: Sequence[Smoothness],
    telescope: Telescope,
    wavelengths: Sequence[float],
    reach: float,
    smallest: float,
    tolerance: Tolerance,
) -> Iterator[Effect]:
    for name, wavelength, smoothness in zip(_places(wavelengths), wavelengths, smooth, strict=True):
        yield from reach_effects(smoothness.surfaces, telescope, wavelength, reach, smallest, tolerance, name)


def _places(wavelengths: Sequence[float]) -> list[str]:
    """At which wavelength, in words, where there are several."""
    return [f" at {name}" if len(wavelengths) > 1 else "" for name in _wavelength_names(wavelengths)]


def _wavelength_names(wavelengths: Sequence[float]) -> list[str]:
    return [f"{1e6 * wavelength:.6g} nm" for wavelength in wavelengths]


def _field_names(telescope: Telescope, fields: Sequence[Field]) -> list[str]:
    unit, scale = ("deg", math.degrees(1.0)) if telescope.object_at_infinity else ("mm", 1.0)
    up = 0.5 * math.pi
    return [
        f"{scale * field.radius:.6g} {unit}"
        + (f" at azimuth {math.degrees(field.azimuth):.6g} deg" if field.azimuth != up else "")
        for field in fields
    ]


def _remarks(telescope: Telescope, surfaces: Sequence[Surface], reach: float) -> list[str]:
    """Where the scene leaves what the model means."""
    rough = [telescope.magnified_distance(surface.marginal_height) for surface in surfaces if surface.psd]
    limit = 0.3 * min(rough, default=math.inf)
    if reach <= limit:
        return []
    return [
        f"beyond {limit:.4g} mm from the image point (boxes or pixels reach {reach:.4g} mm) light was scattered by "
        "more than 17 degrees, outside the small angles of Eq. 36"
    ]
