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
_OVERHEAD = 150e6  # the interpreter and its libraries


@dataclass(frozen=True, slots=True)
class Plan:
    """A scene and what it takes.

    ``reach`` [mm] is the farthest distance from the image point that anything asks for; ``half_widths`` [mm] the boxes,
    increasing; ``scatter`` one row of surfaces and ``specular_fractions`` one number per wavelength; ``spots`` one per
    field; ``memory`` and ``output`` in bytes; ``warnings`` one line each.
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
    centre = max((math.hypot(*point) for s in spots for point in ((s.chief_x, s.chief_y), (s.centroid_x, s.centroid_y))))
    reach = math.sqrt(2.0) * float(boxes[-1]) + centre
    if with_cube:
        x_start, x_stop, y_start, y_stop = detector.bounds()
        reach = max(reach, math.hypot(max(-x_start, x_stop), max(-y_start, y_stop)))
    reach += max(math.hypot(max(-s.x_min, s.x_max), max(-s.y_min, s.y_max)) for s in spots)
    planes = detector.sub_pixels**2 + (detector.pixels**2 if detector.oversample > 1 else 0)
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
        memory=_OVERHEAD + (_WORKING_COPIES * jobs * _BYTES * planes if with_cube else 0.0),
        output=float(_BYTES * planes * len(fields) * len(wavelengths)) if with_cube else 0.0,
        warnings=tuple(_remarks(telescope, surfaces, reach)),
    )


def _remarks(telescope: Telescope, surfaces: Sequence[Surface], reach: float) -> list[str]:
    """Where the scene leaves what the model means."""
    remarks = []
    for surface in surfaces:
        horizon = telescope.magnified_distance(surface.marginal_height)
        if surface.psd and reach > 0.3 * horizon:
            remarks.append(
                f"{surface.name}: light {reach:.4g} mm from the image point was scattered by more than 17 degrees "
                f"(d_j = {horizon:.4g} mm), outside the small angles of Eq. 36"
            )
    return remarks
