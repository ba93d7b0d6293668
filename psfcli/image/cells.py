"""The scattered energy in squares anywhere, of a few widths, such as single pixels and sub-pixels [mm]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.image.blur import interval_integrals, moment_orders, moments_to
from psfcli.image.geometric import GeometricalImage
from psfcli.image.narrow import narrow_in_squares
from psfcli.surface.mixture import GaussianMixture
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_LEAST = 1e-31  # of all light: beyond a horizon the mixture may be negative


def scattered_in_cells(
    point: GeometricalImage,
    mixture: GaussianMixture,
    x: Real,
    y: Real,
    width: Real,
    tolerance: Tolerance,
    narrow_error: Real,
    allowance: Real,
) -> Real:
    """The scattered light in squares of ``width`` about (``x``, ``y``) as a fraction of all light, shape of all three.

    PSF_G (x) S of Eq. 44; relative error within ``tolerance.pixel`` and absolute within ``tolerance.ee``. Terms too
    narrow for moments keep their ``narrow_error``, relative, shape (term,), or err by no more than ``tolerance.pixel``
    of what the others send to any square and its ``allowance``, of all light.
    """
    if mixture.weight.size == 0:
        return np.zeros_like(x)
    order = moment_orders(point, mixture, tolerance)
    wide, narrow = order >= 0, order < 0
    energy = _by_moments(mixture.only(wide), point, order.max(initial=0), x, y, 0.5 * width)
    if narrow.any():
        widths, which = np.unique(width, return_inverse=True)
        of_narrow, _ = narrow_in_squares(
            point,
            mixture.only(narrow),
            list(zip(x.tolist(), y.tolist(), strict=True)),
            0.5 * widths,
            narrow_error[narrow],
            np.maximum(0.1 * (tolerance.pixel * energy + allowance), _LEAST),
        )
        energy += of_narrow[np.arange(x.size), which]
    return energy


def _by_moments(
    mixture: GaussianMixture, point: GeometricalImage, order: int, x: Real, y: Real, half_width: Real
) -> Real:
    spot = point.spot
    dx, dy = x - spot.centroid_x, y - spot.centroid_y
    in_x = interval_integrals(dx - half_width, dx + half_width, mixture.variance + spot.rms_x**2, order)
    in_y = interval_integrals(dy - half_width, dy + half_width, mixture.variance + spot.rms_y**2, order)
    energy: Real = mixture.weight @ np.sum(in_x * np.tensordot(moments_to(point, order), in_y, axes=1), axis=0)
    return energy
