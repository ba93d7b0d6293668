"""The geometrical image of a point, PSF_G of Eq. 26: ray errors over the pupil, their statistics and quadratures [mm]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.result import Spot
from psfcli.telescope.aberration import transverse_aberration_along_azimuths
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

_EXACT_RADII, _EXACT_AZIMUTHS = 6, 16  # integrates every second moment of cubic rays exactly
_EXTENT_AZIMUTHS = 256


@dataclass(frozen=True, slots=True)
class RayBundle:
    """Rays through the pupil: landing points ``x``, ``y`` [mm] about the Gaussian image point and their share of

    the light, all of one shape; shares add to 1.
    """

    share: Real
    x: Real
    y: Real


def azimuth_rule(telescope: Telescope, field: Field, count: int) -> Real:
    """Midpoints of ``count`` equal slices of the lit pupil azimuths [rad].

    On a full annulus they lie mirror-symmetrically about the field direction. Tripling the count keeps the old
    midpoints as every third of the new ones.
    """
    start, stop = telescope.pupil.sector
    if telescope.pupil.is_full_annulus:
        start, stop = field.azimuth, field.azimuth + 2.0 * math.pi
    return start + (stop - start) * (np.arange(count) + 0.5) / count


def ray_fans(telescope: Telescope, field: Field, azimuth: Real) -> tuple[Real, Real]:
    """Landing points as cubics in pupil radius along each azimuth: coefficients of x and y, shape (4, azimuths) [mm]."""
    return transverse_aberration_along_azimuths(
        telescope.seidel, telescope.relative_field(field), azimuth, telescope.image_slope
    )


def along_fans(fans: Real, rho: Real) -> Real:
    """The cubics ``fans`` (4, azimuths) at pupil radii ``rho`` (radii or (radii, azimuths)): shape (radii, azimuths)."""
    r = rho[:, None] if rho.ndim == 1 else rho
    return ((fans[3] * r + fans[2]) * r + fans[1]) * r + fans[0]


def ray_bundle(telescope: Telescope, field: Field, radii: int, azimuths: int) -> RayBundle:
    """Rays at the nodes of a quadrature of the uniformly lit pupil (Gauss in rho^2; in azimuth the trapezoid rule on

    a full annulus, Gauss on a sector).
    """
    inner = telescope.pupil.obscuration**2
    node, weight = np.polynomial.legendre.leggauss(radii)
    rho = np.sqrt(inner + (1.0 - inner) * 0.5 * (node + 1.0))
    if telescope.pupil.is_full_annulus:
        azimuth = azimuth_rule(telescope, field, azimuths)
        slice_weight = np.full(azimuths, 1.0 / azimuths)
    else:
        start, stop = telescope.pupil.sector
        slice_node, slice_weight = np.polynomial.legendre.leggauss(azimuths)
        azimuth = start + (stop - start) * 0.5 * (slice_node + 1.0)
        slice_weight = 0.5 * slice_weight
    fans_x, fans_y = ray_fans(telescope, field, azimuth)
    return RayBundle(
        np.outer(0.5 * weight, slice_weight).ravel(),
        along_fans(fans_x, rho).ravel(),
        along_fans(fans_y, rho).ravel(),
    )


def spot_statistics(telescope: Telescope, field: Field) -> Spot:
    """Centroid, chief ray, rms about the centroid and extent of the geometrical spot [mm]."""
    azimuths = _EXACT_AZIMUTHS if telescope.pupil.is_full_annulus else 4 * _EXACT_AZIMUTHS
    rays = ray_bundle(telescope, field, 2 * _EXACT_RADII, azimuths)
    mean_x, mean_y = float(rays.share @ rays.x), float(rays.share @ rays.y)
    fans_x, fans_y = ray_fans(telescope, field, azimuth_rule(telescope, field, _EXTENT_AZIMUTHS))
    rho = np.linspace(telescope.pupil.obscuration, 1.0, 33)
    x, y = along_fans(fans_x, rho), along_fans(fans_y, rho)
    return Spot(
        centroid_x=mean_x,
        centroid_y=mean_y,
        chief_x=float(fans_x[0, 0]),
        chief_y=float(fans_y[0, 0]),
        rms_x=math.sqrt(float(rays.share @ (rays.x - mean_x) ** 2)),
        rms_y=math.sqrt(float(rays.share @ (rays.y - mean_y) ** 2)),
        x_min=float(x.min()),
        x_max=float(x.max()),
        y_min=float(y.min()),
        y_max=float(y.max()),
    )


def nodes_for_spacing(telescope: Telescope, field: Field, spacing: float) -> tuple[int, int]:
    """Radii and azimuths of a pupil quadrature whose rays land at most ``spacing`` [mm] apart."""
    start, stop = telescope.pupil.sector
    azimuth = azimuth_rule(telescope, field, _EXTENT_AZIMUTHS)
    fans_x, fans_y = ray_fans(telescope, field, azimuth)
    rho = np.linspace(telescope.pupil.obscuration, 1.0, 17)
    x, y = along_fans(fans_x, rho), along_fans(fans_y, rho)
    radial = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0)).sum(axis=0).max()
    slices = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)).max() * (_EXTENT_AZIMUTHS / (stop - start))
    return 6 + math.ceil(1.2 * radial / spacing), 12 + math.ceil((stop - start) * slices / spacing)
