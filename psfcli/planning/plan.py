"""What a scene requires, decided in one place before anything is computed: distances, boxes, grids, memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.ensquared import default_half_widths
from psfcli.image.geometric import spot_statistics
from psfcli.image.grid import Detector
from psfcli.image.result import Spot, SurfaceScatter
from psfcli.image.scatter import scatter_table
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_BYTES = 8
_WORKING_COPIES = 3  # the image, a product of matrices before it is added, and a plane on its way to a file
_TOGETHER = 8  # fields computed at a time: more gain nothing
_PIXELS_TOGETHER = 1_000_000  # of all fields computed at a time
_OVERHEAD = 150e6  # the interpreter and its libraries


@dataclass(frozen=True, slots=True)
class Plan:
    """A scene and what it takes.

    ``reach`` [mm] is the farthest distance from the image point that anything asks for; ``half_widths`` [mm] the boxes,
    increasing; ``scatter`` one row of surfaces and ``specular_fractions`` one number per wavelength; ``spots`` one per
    field; ``together`` fields are computed at a time; ``memory`` and ``output`` in bytes; ``warnings`` one line each.
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
    scatter: tuple[tuple[SurfaceScatter, ...], ...]
    specular_fractions: tuple[float, ...]
    spots: tuple[Spot, ...]
    together: int
    memory: float
    output: float
    warnings: tuple[str, ...]

    def report(self) -> dict[str, object]:
        """The plan in plain numbers, as JSON holds them: mm, bytes, fractions of all light."""
        return {
            "asked": {"pixel": self.tolerance.pixel, "ee": self.tolerance.ee},
            "images": len(self.wavelengths) * len(self.fields),
            "grid": self.detector.sub_pixels if self.with_cube else 0,
            "boxes": int(self.half_widths.size),
            "reach_mm": self.reach,
            "specular_fraction": list(self.specular_fractions),
            "memory_bytes": self.memory,
            "output_bytes": self.output,
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
    jobs: int = 1,
) -> Plan:
    """The plan of a scene; ``half_widths`` [mm] None: the default boxes, within the horizon."""
    scatter = tuple(scatter_table(surfaces, telescope, wavelength) for wavelength in wavelengths)
    spots = tuple(spot_statistics(telescope, field) for field in fields)
    boxes = default_half_widths(detector.pixel, detector.pixels) if half_widths is None else np.sort(half_widths)
    reach = math.sqrt(2.0) * float(boxes[-1])
    if with_cube:
        x_start, x_stop, y_start, y_stop = detector.bounds()
        reach = max(reach, math.hypot(max(-x_start, x_stop), max(-y_start, y_stop)))
    reach += 2.0 * _largest_aberration(telescope, fields)
    planes = detector.sub_pixels**2 + (detector.pixels**2 if detector.oversample > 1 else 0)
    together = max(1, min(_TOGETHER, _PIXELS_TOGETHER // planes)) if with_cube else _TOGETHER
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
        scatter=scatter,
        specular_fractions=tuple(math.exp(-sum(row.g for row in rows)) for rows in scatter),
        spots=spots,
        together=together,
        memory=_OVERHEAD + ((_WORKING_COPIES + together - 1) * jobs * _BYTES * planes if with_cube else 0.0),
        output=float(_BYTES * planes * len(fields) * len(wavelengths)) if with_cube else 0.0,
        warnings=tuple(_remarks(telescope, surfaces, reach)),
    )


def _largest_aberration(telescope: Telescope, fields: Sequence[Field]) -> float:
    """A bound of the transverse ray error within max_field, or to the farthest field beyond it [mm].

    The same for every subset of the fields within max_field, so that a sweep in parts gives the numbers of the whole.
    """
    farthest = max([1.0, *(math.hypot(*telescope.relative_field(field)) for field in fields)])
    W = telescope.seidel
    slope = (
        2.0 * abs(W.W020)
        + 4.0 * abs(W.W040)
        + 3.0 * abs(W.W131) * farthest
        + 2.0 * (abs(W.W222) + abs(W.W220)) * farthest**2
        + abs(W.W311) * farthest**3
    )
    return slope / telescope.image_slope


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
