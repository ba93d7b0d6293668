"""System files as dictionaries, read by the judge on its own: from their text to ``TruthSystem`` and pixel edges.

What a system file means is told by its description alone; units are astropy's. Only what the tests' scenes use is read:
spectra by sigma, B and C, squares of pixels.
"""

from __future__ import annotations

import math

from astropy import units

from .system import TruthSystem

Scene = dict


def mm(length: str) -> float:
    """A length as text, in mm."""
    return units.Quantity(length).to_value(units.mm)


def rad(angle: str) -> float:
    """An angle as text, in rad."""
    return units.Quantity(angle).to_value(units.rad)


def judged(scene: Scene, field: int = 0, wavelength: int = 0) -> TruthSystem:
    """The scene at one of its fields and wavelengths, as the judge sees it."""
    telescope, surfaces = scene["telescope"], scene.get("surfaces", [])
    wave = mm(scene["wavelengths"][wavelength])
    media = _indices(surfaces)
    if "focal_length" in telescope:
        slope = mm(telescope["aperture_diameter"]) / (2.0 * mm(telescope["focal_length"]))
    else:  # n' times exit-pupil radius over image distance
        slope = media[-1][1] * mm(telescope["exit_pupil_radius"]) / mm(telescope["image_distance"])
    rough = []
    for surface, (before, after) in zip(surfaces, media, strict=True):
        step = after - before if surface.get("kind") == "refracting" else 2.0 * after
        K = 2.0 * math.pi * abs(step) * math.cos(rad(surface.get("incidence", "0 deg"))) / wave
        given = surface.get("psd", [])
        terms = [(mm(t["sigma"]), mm(t["B"]), t["C"]) for t in (given if isinstance(given, list) else [given])]
        rough.append((K, abs(mm(surface["marginal_height"])) / slope, tuple(terms), after))
    sector = telescope.get("sector")
    return TruthSystem(
        wave,
        tuple(rough),
        slope,
        telescope.get("obscuration", 0.0),
        _seidel([telescope, *surfaces]),
        _relative_field(telescope, scene["fields"][field]),
        tuple(rad(azimuth) for azimuth in sector) if sector else None,
    )


def pixel_edges(detector: dict, i: int, axis: int, *, fine: bool = False) -> tuple[float, float]:
    """From where to where [mm] pixel ``i`` (a sub-pixel if ``fine``) reaches along x (axis 0) or y (axis 1)."""
    n, pixel = detector["pixels"], mm(detector["pixel"])
    middle = 0.5 * n if detector.get("centre", "middle") == "middle" else n // 2 + 0.5
    offset = detector.get("offset", ["0 mm", "0 mm"])[axis]
    shift = float(offset.split()[0]) * pixel if offset.endswith("pix") else mm(offset)
    parts = detector.get("oversample", 1) if fine else 1
    return shift + (i / parts - middle) * pixel, shift + ((i + 1) / parts - middle) * pixel


def window(detector: dict) -> tuple[float, float, float, float]:
    """The whole detector, (x0, x1, y0, y1) [mm]."""
    last = detector["pixels"] - 1
    (x0, _), (_, x1), (y0, _), (_, y1) = (pixel_edges(detector, i, axis) for axis in (0, 1) for i in (0, last))
    return x0, x1, y0, y1


def _indices(surfaces: list[dict]) -> list[tuple[float, float]]:
    """(n, n') at each surface; a mirror stays in the medium it sits in, the first of which is vacuum."""
    media, medium = [], 1.0
    for surface in surfaces:
        before, after = surface.get("index", (medium, medium))
        media.append((before, after))
        medium = after
    return media or [(1.0, 1.0)]


def _seidel(holders: list[dict]) -> dict[str, float]:
    """The sum of all tables [mm]; a table without a reference wavelength has the telescope's."""
    common = holders[0].get("seidel", {}).get("reference_wavelength")
    total: dict[str, float] = {}
    for table in (holder["seidel"] for holder in holders if "seidel" in holder):
        wave = mm(table.get("reference_wavelength", common))
        for name, waves in table.items():
            if name != "reference_wavelength":
                total[name] = total.get(name, 0.0) + waves * wave
    return total


def _relative_field(telescope: dict, field: str | dict) -> tuple[float, float]:
    radius, azimuth = (field["radius"], rad(field["azimuth"])) if isinstance(field, dict) else (field, None)
    if "focal_length" in telescope:
        H = math.tan(rad(radius)) / math.tan(rad(telescope["max_field"]))
    else:
        H = mm(radius) / mm(telescope["max_field"])
    return (0.0, H) if azimuth is None else (H * math.cos(azimuth), H * math.sin(azimuth))
