"""Rules that join several keys. Each sees checked values, of which any may be missing, and yields what it finds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from psfcli.config.build import Values, field_points, indices, spectrum
from psfcli.config.finding import Finding, dig
from psfcli.config.prescription_rules import PRESCRIPTION_RULES

if TYPE_CHECKING:
    from psfcli.config.faults import Steps
    from psfcli.telescope.system import Field


_REFERENCE = "reference_wavelength"

Rule = Callable[[Values], Iterator[Finding]]


def _surfaces(values: Values) -> list[tuple[int, Values]]:
    return [(i, surface) for i, surface in enumerate(values.get("surfaces", [])) if surface is not None]


def _terms(values: Values) -> Iterator[tuple[Steps, Values]]:
    for i, surface in _surfaces(values):
        for j, term in enumerate(surface.get("psd", [])):
            if term is not None:
                yield ("surfaces", i, "psd", j), term


def _wavelengths(values: Values) -> list[float]:
    return [wavelength for wavelength in values.get("wavelengths", []) if wavelength is not None]


def first_marginal_height(values: Values) -> Iterator[Finding]:
    """The marginal ray of an object at infinity meets the first surface at the pupil's rim."""
    diameter = dig(values, "telescope", "aperture_diameter")
    height = dig(values, "surfaces", 0, "marginal_height")
    if not diameter or not height or "image_distance" in values["telescope"]:
        return
    if abs(abs(height) - diameter / 2.0) > 1e-3 * diameter / 2.0:
        problem = f"differs from aperture_diameter/2, {diameter / 2.0:g} mm, by more than 1e-3 of it"
        yield Finding(("surfaces", 0, "marginal_height"), problem, (("telescope", "aperture_diameter"),))


def sector_opens(values: Values) -> Iterator[Finding]:
    """A sector runs from its start to a later stop, at most once around."""
    start, stop = dig(values, "telescope", "sector", 0), dig(values, "telescope", "sector", 1)
    if start is not None and stop is not None and not 0.0 < stop - start <= 2.0 * math.pi * (1.0 + 1e-12):
        yield Finding(("telescope", "sector"), "stop must lie after start, by at most 360 deg")


def bands_open(values: Values) -> Iterator[Finding]:
    """A band runs from a lower to a higher frequency."""
    for steps, term in _terms(values):
        f1, f2 = dig(term, "sigma_band", 0), dig(term, "sigma_band", 1)
        if f1 is not None and f2 is not None and not f1 < f2:
            problem = f"{f1:g}..{f2:g} cycles/mm is no band; write the lower frequency first"
            yield Finding((*steps, "sigma_band"), problem)


def roughness_is_plausible(values: Values) -> Iterator[Finding]:
    """The rms over all spatial frequencies is finite, and no more than a hundred wavelengths."""
    shortest = min(_wavelengths(values), default=math.inf)
    for steps, term in _terms(values):
        given = next((key for key in ("sigma", "A", "S0") if key in term), "")
        band = term.get("sigma_band", [0.0, 1.0])
        if not given or None in band or len(band) != 2 or not band[0] < band[1]:
            continue
        try:
            sigma = spectrum(term).sigma
        except KeyError:  # a sibling is missing or bad, and told
            continue
        except ArithmeticError:
            yield Finding((*steps, given), "cannot be reached: B and the slope leave no roughness in its band")
            continue
        if not sigma <= 100.0 * shortest:
            problem = (
                f"means an rms of {sigma * 1e6:.4g} nm over all spatial frequencies; "
                f"allowed: up to 100 wavelengths, {1e8 * shortest:.4g} nm"
            )
            yield Finding((*steps, given), problem, (("wavelengths", 0),))


def waves_have_a_length(values: Values) -> Iterator[Finding]:
    """Each Seidel table has a reference wavelength, its own or (on a surface) the telescope's."""
    own = dig(values, "telescope", "seidel")
    tables: list[tuple[Steps, Values]] = [(("telescope", "seidel"), own)] if own is not None else []
    if "reference_wavelength" not in (own or {}):
        tables += [(("surfaces", i, "seidel"), s["seidel"]) for i, s in _surfaces(values) if "seidel" in s]
    for steps, table in tables:
        if "reference_wavelength" not in table:
            yield Finding(steps, "missing key (the wavelength whose waves the coefficients count)", (), _REFERENCE)


def refraction_is_complete(values: Values) -> Iterator[Finding]:
    """A refracting surface has its indices, which hold at one wavelength."""
    built = dig(values, "prescription", "surfaces")
    top: Steps = ("surfaces",) if built is None else ("prescription", "surfaces")
    listed = enumerate(dig(values, *top) or [])
    refracting = [(i, surface) for i, surface in listed if surface and surface.get("kind") == "refracting"]
    count = len(values.get("wavelengths", []))
    if refracting and count > 1:
        problem = f"needs exactly one wavelength in the file, got {count}; its index belongs to one"
        yield Finding((*top, refracting[0][0], "kind"), problem, (("wavelengths",),))
    for i, surface in refracting:
        if "index" not in surface and built is None:
            yield Finding(("surfaces", i), "missing key (a refracting surface needs [before, after])", (), "index")


def media_join(values: Values) -> Iterator[Finding]:
    """Light meets a surface in the medium that the one before left it in; a mirror leaves it there."""
    surfaces = values.get("surfaces", [])
    media = indices(surfaces)
    for i, surface in _surfaces(values):
        before, after = media[i]
        left = media[i - 1][1] if i else None
        if surface.get("kind") == "mirror" and before != after:
            yield Finding(("surfaces", i, "index"), f"{before:g} and {after:g} differ; a mirror has one medium")
        elif "index" in surface and None not in (before, left) and before != left:
            problem = f"differs from {left:g}, the index after surfaces[{i - 1}]"
            yield Finding(("surfaces", i, "index", 0), problem, (("surfaces", i - 1, "index", 1),))


def range_advances(values: Values) -> Iterator[Finding]:
    """A range of fields ends elsewhere than it starts."""
    start, stop = dig(values, "fields", "start"), dig(values, "fields", "stop")
    if start is not None and start == stop:
        yield Finding(("fields", "stop"), "is the same as start; write one field as a list", (("fields", "start"),))


def _direction(field: Field) -> tuple[float, float]:
    """The field point with its radius not negative and its azimuth [rad] within one turn; on the axis it has none."""
    turn = 2.0 * math.pi
    azimuth = (field.azimuth + (math.pi if field.radius < 0.0 else 0.0)) % turn
    # to 12 digits: degrees beyond a turn come back with rounding
    return abs(field.radius), round(azimuth, 12) % round(turn, 12) if field.radius else 0.0


def nothing_twice(values: Values) -> Iterator[Finding]:
    """No field, wavelength or box is asked for twice."""
    is_range = isinstance(values.get("fields"), dict)
    asked: dict[Steps, list[Any]] = {
        ("wavelengths",): values.get("wavelengths", []),
        ("fields",): [] if is_range else [field and _direction(field) for field in field_points(values)],
        ("ensquared_energy", "half_widths"): dig(values, "ensquared_energy", "half_widths") or [],
    }
    for steps, listed in asked.items():
        seen: dict[Any, int] = {}
        for i, value in enumerate(listed):
            if value is not None and seen.setdefault(value, i) != i:
                yield Finding((*steps, i), f"is the same as {steps[-1]}[{seen[value]}]; each may stand once")


RULES: tuple[Rule, ...] = (
    first_marginal_height,
    sector_opens,
    bands_open,
    roughness_is_plausible,
    waves_have_a_length,
    refraction_is_complete,
    media_join,
    range_advances,
    nothing_twice,
    *PRESCRIPTION_RULES,
)


def warnings(values: Values) -> Iterator[str]:
    """Remarks on faultless values, one line each."""
    max_field = values["telescope"]["max_field"]
    radii = [abs(field.radius) for field in field_points(values) if field]
    beyond = sum(radius > max_field * (1.0 + 1e-12) for radius in radii)
    if beyond:
        yield f"fields: {beyond} of {len(radii)} lie beyond max_field, where the Seidel table is extrapolated"
    own = {name for name, waves in values["telescope"].get("seidel", {}).items() if waves} - {"W020", _REFERENCE}
    if own and any("seidel" in surface for _, surface in _surfaces(values)):
        yield f"telescope.seidel: {', '.join(sorted(own))} are added to the surfaces' tables; W020 alone may be meant"
