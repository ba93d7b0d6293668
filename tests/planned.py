"""Scenes that tests share, planned as the planner has it and with nothing skipped, and how far images are apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import psfcli
from psfcli import recipe

if TYPE_CHECKING:
    from psfcli.config import System
    from psfcli.image.result import FieldImage
    from psfcli.planning.effects import Effect
    from psfcli.planning.plan import Plan

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
PAPER = CONFIGS / "euv_two_mirror.yaml"
SMALL = ("detector.pixels=10", "detector.oversample=3", "ensquared_energy={half_widths: [2 um, 31.5 um, 1 mm]}")

WEDGE = """schema: 1
wavelengths: [13.5 nm, 20 nm]
telescope:
  image_distance: 2 m
  exit_pupil_radius: 50 mm
  obscuration: 0.3
  sector: [60 deg, 120 deg]
  max_field: 5 mm
  seidel: {reference_wavelength: 13.5 nm, W020: -10, W040: 2, W131: 3, W222: 5}
surfaces:
  - marginal_height: 50 mm
    psd: [{sigma: 0.4 nm, B: 1 mm, C: 1.8}, {sigma: 0.2 nm, B: 0.05 mm, C: 2.5}]
    incidence: 8 deg
  - marginal_height: 20 mm
    psd: {sigma: 0.3 nm, B: 5 mm, C: 1.2}
fields: [0 mm, {radius: 3 mm, azimuth: 30 deg}]
detector: {pixel: 10 um, pixels: 9, oversample: 2, centre: pixel, offset: [0.3 pix, 2 um]}
"""
"""A system with no symmetry: a sector of the pupil, a field off the axes, a window off the middle; for Monte Carlo."""

Images = dict[tuple[int, int], "FieldImage"]


def paper(*overrides: str, fields: list[str] | None = None, accuracy: Any = "standard") -> System:
    """The paper's telescope with a small window, three squares, and other values for some keys."""
    return psfcli.load(PAPER, [*SMALL, *overrides], fields or ["0.3 deg"], accuracy)


def planned(system: System, **options: Any) -> tuple[Plan, Images]:
    """The plan and the images it gives, by wavelength and field."""
    scene = recipe.plan(system, **options)
    return scene, {(w, f): image for w, f, image in recipe.images(scene)}


def effect(scene: Plan, name: str) -> Effect:
    """The one effect of that name."""
    (found,) = [effect for effect in scene.effects if effect.name == name]
    return found


def touched(image: FieldImage, edges_x: np.ndarray, edges_y: np.ndarray) -> np.ndarray:
    """The cells that unscattered light touches, and their eight neighbours."""
    spot, width = image.spot, edges_x[1] - edges_x[0]
    x = (edges_x[1:] > spot.x_min - width) & (edges_x[:-1] < spot.x_max + width)
    y = (edges_y[1:] > spot.y_min - width) & (edges_y[:-1] < spot.y_max + width)
    return np.outer(y, x)


def apart(scene: Plan, mine: FieldImage, full: FieldImage) -> tuple[float, float]:
    """The largest differences of two images of one field: relative, of a sub-pixel, and absolute, of an energy.

    In pixels that unscattered light touches ``ee`` for each of the two is let through (contract, section 4).
    """
    energy = max(
        float(np.max(np.abs(getattr(mine.ensquared, name) - getattr(full.ensquared, name)), initial=0.0))
        for name in ("ee", "ee_chief", "ee_centroid", "ee_unaberrated")
    )
    a, b = ((i.psf if i.psf_over is None else i.psf_over) for i in (mine, full))
    if a is None or b is None:
        return 0.0, energy
    allowance = 2.0 * scene.tolerance.ee * touched(full, scene.detector.edges(0), scene.detector.edges(1))
    excess = np.maximum(np.abs(a - b) - allowance, 0.0)
    return float(np.max(np.divide(excess, b, out=np.zeros_like(b), where=excess > 0.0))), energy
