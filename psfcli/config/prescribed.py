"""What follows from a prescription in a system file: its rays, and the surfaces as the rest of the file lists them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from psfcli.telescope.paraxial import ParaxialTrace, focused, trace
from psfcli.telescope.prescription import OpticalSurface, Prescription

Values = Mapping[str, Any]

_TERMS = tuple(f"A{n}" for n in range(4, 17, 2))


def traced(given: Values, telescope: Values) -> ParaxialTrace:
    """The paraxial trace of a prescription, its stop sized by the telescope's aperture and its last thickness filled.

    Raises ParaxialError where the prescription makes no image, KeyError where one of the values is missing.
    """
    layout: Sequence[Values] = given["surfaces"]
    end = layout[-1]["thickness"]
    bare = Prescription(
        surfaces=tuple(_optical_surfaces(layout, given["index_before"])),
        stop=[surface["name"] for surface in layout].index(given["stop"]),
        stop_radius=1.0,
        image_shift=given.get("image_shift", 0.0),
        object_distance=given.get("object_distance", math.inf),
        index_before=given["index_before"],
    )
    sized = focused(bare, telescope["aperture_diameter"] / 2.0, None if end == "focus" else end)
    return trace(sized, telescope["max_field"])


def finished_surfaces(finishes: Sequence[Values], found: ParaxialTrace) -> Iterator[tuple[Values, tuple[float, float]]]:
    """Each surface of a prescription as an entry of ``surfaces``, and the indices before and after it.

    One that ``finishes`` does not list is smooth; apertures are left out.
    """
    by_name = {finish["name"]: finish for finish in finishes}
    media = [abs(n) for n in found.indices]
    for j, surface in enumerate(found.prescription.surfaces):
        if surface.is_mirror or surface.name in by_name or surface.curvature or media[j] != media[j + 1]:
            entry = {"reflectance": 1.0, "incidence": 0.0, "kind": "mirror" if surface.is_mirror else "refracting"}
            entry |= by_name.get(surface.name, {"name": surface.name})
            yield entry | {"marginal_height": found.marginal.heights[j]}, (media[j], media[j + 1])


def _optical_surfaces(layout: Sequence[Values], index: float) -> Iterator[OpticalSurface]:
    for surface in layout:
        radius, thickness = surface.get("radius", "flat"), surface["thickness"]
        terms = surface.get("aspheric", {})
        index = surface.get("index", index)
        yield OpticalSurface(
            name=surface["name"],
            curvature=0.0 if radius == "flat" else 1.0 / radius,
            thickness=0.0 if thickness == "focus" else thickness,
            conic=surface.get("conic", 0.0),
            aspheric=tuple(terms.get(name, 0.0) for name in _TERMS) if terms else (),
            index=index,
            is_mirror=surface["kind"] == "mirror",
        )
