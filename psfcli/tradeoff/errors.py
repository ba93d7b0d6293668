"""How wrong an image is: its largest errors against the truth, and those that chance lets expect."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from psfcli.image.grid import Detector
from psfcli.image.result import FieldImage, Spot
from psfcli.planning.plan import Plan
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FLOOR = 1e-30  # of all light: below it, values are promised to be below it and no more


def touched(spot: Spot, detector: Detector) -> Mask:
    """The sub-pixels [y, x] that unscattered light touches, with their eight neighbours."""
    x, y = (
        (edges[1:] >= low - detector.sub_pixel) & (edges[:-1] <= high + detector.sub_pixel)
        for edges, low, high in (
            (detector.edges(0), spot.x_min, spot.x_max),
            (detector.edges(1), spot.y_min, spot.y_max),
        )
    )
    return np.logical_and.outer(y, x)


def pixel_error(energy: Real, truth: Real, allowance: Real) -> float:
    """The largest (|error| - allowance)/truth of a pixel, 0 where no error exceeds its allowance; arrays [y, x]."""
    excess = np.abs(energy - truth) - allowance
    wrong = (excess > 0.0) & (np.maximum(np.abs(energy), truth) > _FLOOR)
    with np.errstate(divide="ignore"):
        return float(np.max(excess[wrong] / truth[wrong], initial=0.0))


def promised_error(image: FieldImage, truth: FieldImage, detector: Detector, asked: Tolerance) -> Tolerance:
    """The largest errors among all that a run promises: pixels, sub-pixels, and energies in every box about any centre.

    Pixels that unscattered light touches, and their neighbours, are allowed the ``ee`` asked for, as promised.
    """
    worst = 0.0
    for energy, true, oversample in ((image.psf, truth.psf, 1), (image.psf_over, truth.psf_over, detector.oversample)):
        if energy is not None and true is not None:
            grid = Detector(detector.pixel, detector.pixels, oversample, detector.centre, detector.offset)
            worst = max(worst, pixel_error(energy, true, np.where(touched(truth.spot, grid), asked.ee, 0.0)))
    boxes = ("ee", "ee_chief", "ee_centroid", "ee_unaberrated")
    apart = [np.abs(getattr(image.ensquared, name) - getattr(truth.ensquared, name)).max() for name in boxes]
    return Tolerance(worst, float(max(apart)))


def rival_error(pixels: Real, energies: Real, truth: FieldImage, scene: Plan) -> Tolerance:
    """The largest errors of what promises nothing: ``pixels`` [y, x] of the detector, ``energies`` [box].

    Judged are boxes at least a pixel wide and within the window, about the Gaussian image point (nan if there is none).
    Pixels that unscattered light touches, and their neighbours, are allowed the error of the energies found so.
    """
    assert truth.psf is not None
    detector, half_width = scene.detector, scene.half_widths
    nearest = min(abs(bound) for bound in detector.bounds())
    judged = (half_width > 0.499 * detector.pixel) & (half_width < (1.0 + 1e-9) * nearest)
    ee = float(np.max(np.abs(energies - truth.ensquared.ee)[judged])) if judged.any() else math.nan
    grid = Detector(detector.pixel, detector.pixels, 1, detector.centre, detector.offset)
    allowance = np.where(touched(truth.spot, grid), 0.0 if math.isnan(ee) else ee, 0.0)
    return Tolerance(pixel_error(pixels, truth.psf, allowance), ee)


def expected_pixel_error(count: float, truth: FieldImage, detector: Detector) -> float:
    """The median of the largest relative pixel error of ``count`` random rays, away from the unscattered light.

    The count in a pixel of energy P has the relative standard error s = sqrt((1 - P)/(P count)); independent normal
    errors all stay below m with probability prod erf(m/(s sqrt 2)), here one half. Valid for P count >> 1; nan where no
    other light falls.
    """
    assert truth.psf is not None
    grid = Detector(detector.pixel, detector.pixels, 1, detector.centre, detector.offset)
    P = truth.psf[~touched(truth.spot, grid) & (truth.psf > _FLOOR)]
    if P.size == 0:
        return math.nan
    s = np.sqrt(2.0 * (1.0 - P) / (P * count))

    def surplus(m: float) -> float:
        return math.log(2.0) + float(np.sum(np.log(special.erf(m / s))))

    return float(optimize.brentq(surplus, 1e-3 * s.max(), 10.0 * s.max(), rtol=1e-3))
