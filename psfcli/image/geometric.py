"""The geometrical image of a point, PSF_G of Eq. 26: ray errors, their statistics and quadratures [mm]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.extent import extent
from psfcli.image.quadrature import gauss_panels
from psfcli.image.result import Spot
from psfcli.telescope.aberration import transverse_aberration_along_azimuths
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]

MAX_MOMENT = 14
LARGEST_PANEL = 32  # nodes of Gauss's rule along rays
_EXACT_RADII, _EXACT_AZIMUTHS = 12, 16  # integrates every second moment of cubic rays exactly
_EXTENT_AZIMUTHS = 256


@dataclass(frozen=True, slots=True)
class RayBundle:
    """Rays through the pupil: landing points ``x``, ``y`` [mm] about the Gaussian image point and their share of

    the light, all of one shape; shares add to 1.
    """

    share: Real
    x: Real
    y: Real


@dataclass(frozen=True, slots=True)
class GeometricalImage:
    """PSF_G of one field point.

    ``rays`` integrate its moments to MAX_MOMENT (exactly on a full annulus); ``moments`` Q_ab of the spot about its
    centroid, with the Gaussian part of its rms taken out (blur.py);
    ``mirror_symmetric``: x and -x are alike.
    """

    telescope: Telescope
    field: Field
    spot: Spot
    rays: RayBundle
    moments: Real
    mirror_symmetric: bool

    @property
    def is_a_point(self) -> bool:
        """Whether all rays land together: any one of them tells where."""
        spot = self.spot
        return spot.x_min == spot.x_max and spot.y_min == spot.y_max


def azimuth_rule(telescope: Telescope, field: Field, count: int) -> Real:
    """Midpoints of ``count`` equal slices of the lit pupil azimuths [rad].

    On a full annulus they lie mirror-symmetrically about the field direction. Tripling the count keeps the old
    midpoints as every third of the new ones.
    """
    start, stop = telescope.pupil.sector
    if telescope.pupil.is_full_annulus:
        # a field on the axis has no direction: its image, too, is mirrored at the y axis
        start = field.azimuth if telescope.relative_field(field)[0] != 0.0 else 0.5 * math.pi
        stop = start + 2.0 * math.pi
    return start + (stop - start) * (np.arange(count) + 0.5) / count


def ray_fans(telescope: Telescope, field: Field, azimuth: Real) -> tuple[Real, Real]:
    """Landing points as cubics in pupil radius along azimuths: coefficients of x and y, shape (4, azimuths) [mm]."""
    return transverse_aberration_along_azimuths(
        telescope.seidel, telescope.relative_field(field), azimuth, telescope.image_slope
    )


def along_fans(fans: Real, rho: Real) -> Real:
    """The cubics ``fans`` (4, ..., azimuths) at pupil radii ``rho`` (..., radii): shape (..., radii, azimuths)."""
    r, fan = rho[..., None], fans[..., None, :]
    along: Real = ((fan[3] * r + fan[2]) * r + fan[1]) * r + fan[0]
    return along


def pupil_azimuths(telescope: Telescope, field: Field, count: int, *, half: bool = False) -> tuple[Real, Real]:
    """Nodes [rad] and weights, adding to 1, in lit azimuth: trapezoid rule on a full annulus, Gauss's on a sector.

    At least ``count``, and ``count`` if it is a multiple of LARGEST_PANEL. ``half``, for mirror-symmetric images and an
    even number: those on one side of the field direction, standing for both.
    """
    if telescope.pupil.is_full_annulus:
        azimuth = azimuth_rule(telescope, field, count)[: count // 2 if half else count]
        return azimuth, np.full(azimuth.size, 1.0 / azimuth.size)
    start, stop = telescope.pupil.sector
    node, weight = gauss_panels(count, LARGEST_PANEL)
    return start + (stop - start) * 0.5 * (node + 1.0), 0.5 * weight


def ray_bundle(telescope: Telescope, field: Field, radii: int, azimuths: int) -> RayBundle:
    """Rays at the nodes of a quadrature of the uniformly lit pupil, Gauss's rule in rho times ``pupil_azimuths``.

    Without aberrations one ray stands for all.
    """
    if telescope.seidel == SeidelTable():
        return RayBundle(np.ones(1), np.zeros(1), np.zeros(1))
    inner = telescope.pupil.obscuration
    node, weight = gauss_panels(radii)
    rho = inner + (1.0 - inner) * 0.5 * (node + 1.0)
    azimuth, slice_weight = pupil_azimuths(telescope, field, azimuths)
    fans_x, fans_y = ray_fans(telescope, field, azimuth)
    return RayBundle(
        np.outer(rho * weight / (1.0 + inner), slice_weight).ravel(),
        along_fans(fans_x, rho).ravel(),
        along_fans(fans_y, rho).ravel(),
    )


def geometrical_image(telescope: Telescope, field: Field) -> GeometricalImage:
    """PSF_G of a field point reduced to what later steps ask of it."""
    spot = spot_statistics(telescope, field)
    azimuths = (2 if telescope.pupil.is_full_annulus else 8) * (MAX_MOMENT + 1)
    rays = ray_bundle(telescope, field, 2 * MAX_MOMENT, azimuths)
    symmetric = _is_mirror_symmetric(telescope, field)
    return GeometricalImage(
        telescope=telescope,
        field=field,
        spot=spot,
        rays=rays,
        moments=_quasi_moments(rays, spot, symmetric=symmetric),
        mirror_symmetric=symmetric,
    )


def _is_mirror_symmetric(telescope: Telescope, field: Field) -> bool:
    """Whether the image is the same for x and -x."""
    return telescope.pupil.is_full_annulus and telescope.relative_field(field)[0] == 0.0


def spot_statistics(telescope: Telescope, field: Field) -> Spot:
    """Centroid, chief ray, rms about the centroid and extent of the geometrical spot [mm]."""
    azimuths = _EXACT_AZIMUTHS if telescope.pupil.is_full_annulus else 4 * _EXACT_AZIMUTHS
    rays = ray_bundle(telescope, field, _EXACT_RADII, azimuths)
    mean_x, mean_y = float(rays.share @ rays.x), float(rays.share @ rays.y)
    chief_x, chief_y = (float(fans[0, 0]) for fans in ray_fans(telescope, field, np.zeros(1)))
    x_min, x_max, y_min, y_max = extent(
        lambda azimuth: ray_fans(telescope, field, azimuth), telescope.pupil.obscuration, *telescope.pupil.sector
    ).tolist()
    if _is_mirror_symmetric(telescope, field):
        mean_x, x_min = 0.0, -x_max + 0.0  # and not rounding: boxes about it keep the symmetry
    return Spot(
        centroid_x=mean_x,
        centroid_y=mean_y,
        chief_x=chief_x,
        chief_y=chief_y,
        rms_x=math.sqrt(float(rays.share @ (rays.x - mean_x) ** 2)),
        rms_y=math.sqrt(float(rays.share @ (rays.y - mean_y) ** 2)),
        x_min=x_min,
        x_max=x_max,
        y_min=y_min,
        y_max=y_max,
    )


def _quasi_moments(rays: RayBundle, spot: Spot, *, symmetric: bool) -> Real:
    """E[He_a(eps_x - cx; rms_x^2) He_b(eps_y - cy; rms_y^2)]/(a! b!) [mm^(a+b)] for a + b <= MAX_MOMENT, zero beyond.

    Shape (MAX_MOMENT + 1,) * 2. ``symmetric``: x and -x are alike.
    """
    order = np.arange(MAX_MOMENT + 1)
    factorial = np.cumprod(np.maximum(order, 1)).astype(np.float64)
    x = _scaled_hermite(rays.x - spot.centroid_x, spot.rms_x) / factorial[:, None]
    y = _scaled_hermite(rays.y - spot.centroid_y, spot.rms_y) / factorial[:, None]
    moments = (x * rays.share) @ y.T
    moments[np.add.outer(order, order) > MAX_MOMENT] = 0.0
    if symmetric:
        moments[1::2] = 0.0  # rounding, where symmetry has nothing
    return moments


def _scaled_hermite(x: Real, rms: float) -> Real:
    """He_n(x; rms^2) for n = 0..MAX_MOMENT, shape (MAX_MOMENT + 1, ray): He_(n+1) = x He_n - n rms^2 He_(n-1)."""
    out = np.empty((MAX_MOMENT + 1, x.size))
    out[0] = 1.0
    out[1] = x
    for n in range(1, MAX_MOMENT):
        out[n + 1] = x * out[n] - n * rms**2 * out[n - 1]
    return out
