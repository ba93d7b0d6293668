"""System files drawn at random over everything a user may have: ``drawn(seed, number)`` is one of them.

Draw ``number`` of ``seed`` needs no other draw: its generator is seeded by the pair. Quantities that span decades are
drawn evenly in the logarithm, and a share of the draws sits on the special values: no aberration, no obscuration, no
scatter from a surface, the axis, whole slopes.

Aberrations are then scaled down to what geometrical optics with scatter is asked for: a spot, the largest extent of the
ray errors along x or y, below ``PIXELS_ACROSS`` pixels and ``CORES_ACROSS`` scatter cores. The core is the knee
lambda d/B of the term for which it is narrowest: every term counts, however little it scatters, because on its own core
even a faint term is what a pixel sees. Distortion moves the spot and does not widen it: it is held to as many pixels.
Squares and windows end at the horizon, the smallest d_j of the rough surfaces, beyond which scattering angles mean
nothing.
"""

from __future__ import annotations

import math

import numpy as np

from .geometry import pupil_rule, ray_error
from .scenes import Scene, judged
from .system import TruthSystem, sigma_for_phase_variance

PIXELS_ACROSS, CORES_ACROSS = 200.0, 1000.0
_MOST_SUB_PIXELS = 250  # along an edge: keeps a draw fast
_CENTRES = "middle", "middle", "pixel"


def drawn(seed: int, number: int) -> Scene:
    """The system file as a dictionary; an object at infinity, one wavelength and one field."""
    random = np.random.default_rng([seed, number])
    wavelength, focal = _log(random, 1e-6, 6e-4), _log(random, 100.0, 2e4)  # mm
    slope = 0.5 / _log(random, 1.0, 100.0)  # of the marginal ray: half of one over the focal ratio
    pixel = _log(random, 1e-3, 0.05)
    surfaces = [
        _surface(random, wavelength, focal * slope * (1.0 if j == 0 else _log(random, 0.05, 1.2)))
        for j in range(random.integers(1, 5))
    ]
    max_field = _log(random, 0.01, 5.0)
    scene: Scene = {
        "schema": 1,
        "title": f"draw {number} of seed {seed}",
        "wavelengths": [f"{wavelength!r} mm"],
        "telescope": {
            "focal_length": f"{focal!r} mm",
            "aperture_diameter": f"{2.0 * focal * slope!r} mm",
            "obscuration": _sometimes(random, 0.8, random.uniform(0.0, 0.95), 0.0),
            "max_field": f"{max_field!r} deg",
            "seidel": {"reference_wavelength": f"{wavelength!r} mm", **_aberrations(random)},
        },
        "surfaces": surfaces,
        "fields": [_field(random, max_field)],
        "detector": {"pixel": f"{pixel!r} mm", **_window(random)},
    }
    if random.random() < 0.15:
        first = float(random.uniform(-180.0, 180.0))
        scene["telescope"]["sector"] = [f"{first!r} deg", f"{first + random.uniform(20.0, 350.0)!r} deg"]
    _scale_spot(random, scene, pixel)
    scene["ensquared_energy"] = {"half_widths": [f"{w!r} mm" for w in _half_widths(random, scene, pixel)]}
    return scene


def spot_extent(system: TruthSystem) -> float:
    """The largest extent of the ray errors along x or y [mm]."""
    x, y, _ = pupil_rule(system, 24, 96)
    return max(float(np.ptp(error)) for error in ray_error(system, x, y))


def core_width(system: TruthSystem) -> float:
    """The narrowest knee lambda d/B of the scatter [mm]; infinite when nothing scatters."""
    return min((system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms), default=math.inf)


def _log(random: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def _sometimes(random: np.random.Generator, share: float, value: float, otherwise: float) -> float:
    return float(value if random.random() < share else otherwise)


def _surface(random: np.random.Generator, wavelength: float, height: float) -> dict:
    """A mirror of TIS 1e-8..0.9999 shared by one to three terms, or, one time in eight, a smooth one."""
    surface: dict = {"marginal_height": f"{height!r} mm"}
    terms = random.integers(1, 4)
    shares = np.exp(random.uniform(-6.0, 0.0, terms))
    total = -math.log1p(-0.9999)
    phase_variances = _log(random, 1e-8, total) * shares / shares.sum()
    psd = [_term(random, wavelength, float(g)) for g in phase_variances]
    if random.random() > 0.125:
        surface["psd"] = psd if terms > 1 else psd[0]
    return surface


def _term(random: np.random.Generator, wavelength: float, g: float) -> dict:
    C, B = float(random.uniform(1.05, 8.0)), _log(random, 5e-3, 100.0)
    C = round(C) if C > 2.0 and random.random() < 0.1 else C
    sigma = sigma_for_phase_variance(g, 4.0 * math.pi / wavelength, wavelength, B, C)
    return {"sigma": f"{sigma!r} mm", "B": f"{B!r} mm", "C": C}


def _aberrations(random: np.random.Generator) -> dict[str, float]:
    """Up to 300 waves of each, half of them from 0.01 waves on in the logarithm, a quarter of them exactly none."""

    def waves() -> float:
        size = _log(random, 0.01, 300.0) if random.random() < 0.5 else random.uniform(0.0, 300.0)
        return _sometimes(random, 0.75, size * random.choice([-1.0, 1.0]), 0.0)

    table = {name: waves() for name in ("W020", "W040", "W131", "W222", "W220", "W311")}
    return dict.fromkeys(table, 0.0) if random.random() < 0.1 else table


def _field(random: np.random.Generator, max_field: float) -> dict[str, str]:
    radius = _sometimes(random, 0.85, random.uniform(0.0, max_field), 0.0)
    return {"radius": f"{radius!r} deg", "azimuth": f"{float(random.uniform(-180.0, 360.0))!r} deg"}


def _window(random: np.random.Generator) -> dict:
    pixels = round(_log(random, 1.0, 64.0))
    oversample = int(min(random.integers(1, 10), max(1, _MOST_SUB_PIXELS // pixels)))
    window: dict = {"pixels": pixels, "oversample": oversample, "centre": str(random.choice(_CENTRES))}
    if random.random() < 0.5:
        most = 0.5 if random.random() < 0.8 else 5.0
        window["offset"] = [f"{float(shift)!r} pix" for shift in random.uniform(-most, most, 2)]
    return window


def _scale_spot(random: np.random.Generator, scene: Scene, pixel: float) -> None:
    """Scale the aberrations that widen the spot, and distortion on its own, where they exceed what is drawn."""
    seidel = scene["telescope"]["seidel"]
    system = judged(scene)
    widest = min(PIXELS_ACROSS * pixel, CORES_ACROSS * core_width(system))
    factor = widest / max(spot_extent(system), 1e-300)
    shift = judged({**scene, "telescope": {**scene["telescope"], "seidel": _only(seidel, {"W311"})}})
    moved = math.hypot(*ray_error(shift, 0.0, 0.0))
    size, distance = _log(random, 1e-2, 0.99), _log(random, 1e-2, 0.99)
    for name in seidel.keys() - {"reference_wavelength", "W311"}:
        seidel[name] *= float(size * factor) if factor < 1.0 else 1.0
    if moved > PIXELS_ACROSS * pixel:
        seidel["W311"] *= float(distance * PIXELS_ACROSS * pixel / moved)


def _only(seidel: dict, names: set[str]) -> dict:
    return {k: v for k, v in seidel.items() if k in names | {"reference_wavelength"}}


def _half_widths(random: np.random.Generator, scene: Scene, pixel: float) -> list[float]:
    """Eight half widths [mm], increasing, from far below to far above a pixel, and not beyond the horizon."""
    system = judged(scene)
    horizon = min((s.d for s in system.surfaces), default=math.inf)
    most = min(1e4 * pixel, horizon)
    widths = {0.5 * pixel, pixel * _log(random, 1e-3, 0.1), most * _log(random, 0.03, 1.0)}
    if (extent := spot_extent(system)) > 1e-6 * pixel:
        widths.add(min(0.5 * extent * _log(random, 0.2, 2.0), most))
    while len(widths) < 8:
        widths.add(pixel * _log(random, 1e-2, most / pixel))
    return sorted(float(max(w, 1e-9)) for w in widths)
