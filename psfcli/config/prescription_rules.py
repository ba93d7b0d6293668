"""Rules of a prescription: names that meet, light that goes on, an image that is there."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from psfcli.config.finding import Finding, dig
from psfcli.config.prescribed import Values, traced
from psfcli.telescope.paraxial import ParaxialError, ParaxialTrace
from psfcli.telescope.seidel_sums import surface_tables, system_table

if TYPE_CHECKING:
    from psfcli.config.faults import Steps

_LAYOUT: Steps = ("prescription", "surfaces")
_MOST_WAVES = 1e6
_FOCAL_LENGTHS = (1.0, 1e6)
_LEAST_HEIGHT = 1e-6


def _layout(values: Values) -> Sequence[Values | None]:
    return dig(values, *_LAYOUT) or []


def _names(values: Values) -> list[str]:
    """The names of the surfaces; none where one is bad or stands twice, for another may be meant."""
    names = [dig(surface, "name") for surface in _layout(values)]
    return [] if None in names or len(set(names)) < len(names) else names


def _unknown(names: Sequence[str], name: str) -> str:
    close = difflib.get_close_matches(name, names, 1)
    advice = f"did you mean {close[0]}?" if close else f"allowed: {', '.join(names[:10])}"
    return f"is no surface of the prescription; {advice}"


def names_are_distinct(values: Values) -> Iterator[Finding]:
    """No two surfaces of a prescription have one name, and none is finished twice."""
    for steps in (_LAYOUT, ("surfaces",)) if "prescription" in values else ():
        seen: dict[str, int] = {}
        for i, surface in enumerate(dig(values, *steps) or []):
            name = dig(surface, "name")
            if name is not None and seen.setdefault(name, i) != i:
                yield Finding((*steps, i, "name"), f"is the name of {steps[-1]}[{seen[name]}] too")


def names_are_known(values: Values) -> Iterator[Finding]:
    """The stop and every finish belong to a surface of the prescription; an aperture has no finish."""
    names = _names(values)
    stop = dig(values, "prescription", "stop")
    if names and stop is not None and stop not in names:
        yield Finding(("prescription", "stop"), _unknown(names, stop))
    for i, surface in enumerate(values.get("surfaces", [])) if names else ():
        name = dig(surface, "name")
        if name is not None and name not in names:
            yield Finding(("surfaces", i, "name"), _unknown(names, name))
        elif name is not None and dig(_layout(values), names.index(name), "kind") == "aperture":
            yield Finding(("surfaces", i, "name"), "is an aperture, which has no finish")


def light_goes_on(values: Values) -> Iterator[Finding]:
    """Each thickness leads on the way light goes, which a mirror turns; the last one leads to the detector."""
    layout = _layout(values)
    mirrors: int | None = 0
    for i, surface in enumerate(layout):
        kind = dig(surface, "kind")
        mirrors = None if kind is None or mirrors is None else mirrors + (kind == "mirror")
        thickness = dig(surface, "thickness")
        steps: Steps = (*_LAYOUT, i, "thickness")
        if thickness == "focus" and i < len(layout) - 1:
            yield Finding(steps, "is for the last surface; write the distance to the next vertex")
        elif isinstance(thickness, float) and mirrors is not None and thickness * (-1) ** mirrors < 0.0:
            way = "-z" if mirrors % 2 else "+z"
            count = f"{mirrors} mirror{'s' * (mirrors != 1)}"
            yield Finding(steps, f"leads against the light, which goes towards {way} after {count}; turn its sign")
    if "image_shift" in values.get("prescription", {}) and isinstance(dig(layout, -1, "thickness"), float):
        problem = "means nothing where the last thickness leads to the detector; write focus there"
        yield Finding(("prescription", "image_shift"), problem, ((*_LAYOUT, len(layout) - 1, "thickness"),))


def an_image_is_made(values: Values) -> Iterator[Finding]:
    """Light converges on an image behind the last surface, within the ranges that these files allow.

    For values whose ``telescope`` and ``prescription`` have no other fault.
    """
    try:
        found = traced(values["prescription"], values["telescope"])
        yield from _out_of_range(values, found)
    except ParaxialError as problem:
        yield Finding(("prescription",), str(problem))
    except ArithmeticError:
        yield Finding(("prescription",), "its rays leave all bounds; look for a wrong unit")


def _out_of_range(values: Values, found: ParaxialTrace) -> Iterator[Finding]:
    direction = math.copysign(1.0, found.indices[-1])
    if direction * found.image_distance + found.prescription.image_shift <= 0.0:
        shifted = "image_shift" in values["prescription"]
        end: Steps = ("prescription", "image_shift") if shifted else (*_LAYOUT, len(_layout(values)) - 1, "thickness")
        yield Finding(end, "puts the detector at the last surface or before it")
    focal_length = values["telescope"]["aperture_diameter"] / (2.0 * found.image_slope)
    if math.isinf(found.prescription.object_distance) and not _FOCAL_LENGTHS[0] <= focal_length <= _FOCAL_LENGTHS[1]:
        yield Finding(("prescription",), f"a focal length of {focal_length:.6g} mm; allowed: 1 mm..1 km")
    for i, surface in enumerate(found.prescription.surfaces):
        height = found.marginal.heights[i]
        if (1.0 + surface.conic) * (surface.curvature * height) ** 2 >= 1.0:
            problem = (
                f"with its conic leaves no surface {abs(height):.6g} mm from the axis, where the marginal ray passes"
            )
            yield Finding((*_LAYOUT, i, "radius"), problem, (("telescope", "aperture_diameter"),))
    in_image = {
        s.name
        for s, y in zip(found.prescription.surfaces, found.marginal.heights, strict=True)
        if abs(y) < _LEAST_HEIGHT
    }
    for i, finish in enumerate(values.get("surfaces", [])):
        if dig(finish, "psd") and dig(finish, "name") in in_image:
            yield Finding(("surfaces", i, "name"), "lies in an image, where the scatter of its psd is not modelled")
    yield from _too_aberrated(values, found)


def _too_aberrated(values: Values, found: ParaxialTrace) -> Iterator[Finding]:
    wavelength = dig(values, "wavelengths", 0)
    if not wavelength:
        return
    for tables, what in (((system_table(found),), "the system"), (surface_tables(found), "a surface")):
        for table in tables:
            largest = max((getattr(table, name) for name in table.__slots__), key=lambda w: (math.isnan(w), abs(w)))
            if not abs(largest) <= _MOST_WAVES * wavelength:
                waves = f"{largest / wavelength:.3g} waves"
                yield Finding(("prescription",), f"an aberration of {waves} in {what}; allowed: up to 1e6")
                return


PRESCRIPTION_RULES: tuple[Callable[[Values], Iterator[Finding]], ...] = (
    names_are_distinct,
    names_are_known,
    light_goes_on,
)
