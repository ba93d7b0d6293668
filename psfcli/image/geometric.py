"""The geometrical image of a point, PSF_G of Eq. 26: ray errors, their statistics and quadratures [mm]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from psfcli.image.extent import extents
from psfcli.image.quadrature import gauss_panels
from psfcli.image.result import Spot
from psfcli.telescope.aberration import transverse_aberration_along_azimuths
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Telescope

Real = NDArray[np.float64]
Index = NDArray[np.intp]

MAX_MOMENT = 14
LARGEST_PANEL = 32  # nodes of Gauss's rule along rays
_EXACT_RADII, _EXACT_AZIMUTHS = 12, 16  # integrates every second moment of cubic rays exactly


@dataclass(frozen=True, slots=True)
class RayBundle:
    """Rays through the pupil: landing points ``x``, ``y`` [mm] about the Gaussian image point and their share of

    the light, all of one shape; shares add to 1.
    """

    share: Real
    x: Real
    y: Real


@dataclass(frozen=True)
class GeometricalImage:
    """PSF_G of one field point; ``mirror_symmetric``: x and -x are alike."""

    telescope: Telescope
    field: Field
    spot: Spot
    mirror_symmetric: bool

    @cached_property  # pixels alone ask for it
    def moments(self) -> Real:
        """Q_ab of the spot about its centroid, with the Gaussian part of its rms taken out (blur.py) [mm^(a+b)].

        E[He_a(eps_x - cx; rms_x^2) He_b(eps_y - cy; rms_y^2)]/(a! b!) for a + b <= MAX_MOMENT, zero beyond: shape
        (MAX_MOMENT + 1, MAX_MOMENT + 1). Exact on a full annulus.
        """
        (rays,) = moment_rays(self.telescope, [self.field])
        spot, order = self.spot, np.arange(MAX_MOMENT + 1)
        factorial = np.cumprod(np.maximum(order, 1)).astype(np.float64)[:, None]
        x = _scaled_hermite(rays.x - spot.centroid_x, spot.rms_x) / factorial
        y = _scaled_hermite(rays.y - spot.centroid_y, spot.rms_y) / factorial
        moments: Real = (x * rays.share) @ y.T
        moments[np.add.outer(order, order) > MAX_MOMENT] = 0.0
        if self.mirror_symmetric:
            moments[1::2] = 0.0  # rounding, where symmetry has nothing
        return moments

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


def ray_bundles(telescope: Telescope, fields: Sequence[Field], radii: int, azimuths: int) -> list[RayBundle]:
    """Rays of each field at the nodes of a quadrature of the uniformly lit pupil.

    Gauss's rule in rho times ``pupil_azimuths``. Without aberrations one ray stands for all.
    """
    if telescope.seidel == SeidelTable():
        return [RayBundle(np.ones(1), np.zeros(1), np.zeros(1))] * len(fields)
    inner = telescope.pupil.obscuration
    node, weight = gauss_panels(radii)
    rho = inner + (1.0 - inner) * 0.5 * (node + 1.0)
    azimuth, slice_weight = zip(*(pupil_azimuths(telescope, field, azimuths) for field in fields), strict=True)
    share = np.outer(rho * weight / (1.0 + inner), slice_weight[0]).ravel()
    relative = _relative_fields(telescope, fields)[..., None]
    fans = transverse_aberration_along_azimuths(
        telescope.seidel, tuple(relative), np.stack(azimuth), telescope.image_slope
    )
    x, y = (along_fans(of, rho).reshape(len(fields), -1) for of in fans)
    return [RayBundle(share, *landing) for landing in zip(x, y, strict=True)]


def geometrical_images(telescope: Telescope, fields: Sequence[Field]) -> list[GeometricalImage]:
    """PSF_G of each field point."""
    return [
        GeometricalImage(telescope, field, spot, _is_mirror_symmetric(telescope, field))
        for field, spot in zip(fields, spots(telescope, fields), strict=True)
    ]


def moment_rays(telescope: Telescope, fields: Sequence[Field]) -> list[RayBundle]:
    """Rays that integrate all moments of each spot to MAX_MOMENT, exactly on a full annulus."""
    azimuths = (2 if telescope.pupil.is_full_annulus else 8) * (MAX_MOMENT + 1)
    return ray_bundles(telescope, fields, 2 * MAX_MOMENT, azimuths)


def spots(telescope: Telescope, fields: Sequence[Field]) -> list[Spot]:
    """Centroid, chief ray, rms about the centroid and extent of the geometrical spot of each field [mm]."""
    relative = _relative_fields(telescope, fields)

    def fans(azimuth: Real, of: Index) -> tuple[Real, Real]:
        return transverse_aberration_along_azimuths(
            telescope.seidel, tuple(relative[:, of]), azimuth, telescope.image_slope
        )

    mean, rms = spot_moments(telescope, fields)
    chief = np.stack(fans(np.zeros(len(fields)), np.arange(len(fields))))[:, 0].T
    bounds = extents(fans, telescope.pupil.obscuration, *telescope.pupil.sector, len(fields))
    for n, field in enumerate(fields):
        if _is_mirror_symmetric(telescope, field):
            mean[n, 0], bounds[n, 0] = 0.0, -bounds[n, 1] + 0.0  # and not rounding: boxes about it keep the symmetry
    return [Spot(*row) for row in np.concatenate([mean, chief, rms, bounds], axis=1).tolist()]


def spot_moments(telescope: Telescope, fields: Sequence[Field]) -> tuple[Real, Real]:
    """Centroid and rms about it of the geometrical spot of each field [mm], shape (field, 2) each."""
    azimuths = _EXACT_AZIMUTHS if telescope.pupil.is_full_annulus else 4 * _EXACT_AZIMUTHS
    rays = ray_bundles(telescope, fields, _EXACT_RADII, azimuths)
    landing = np.array([(of.x, of.y) for of in rays])
    mean = landing @ rays[0].share
    return mean, np.sqrt((landing - mean[..., None]) ** 2 @ rays[0].share)


def _relative_fields(telescope: Telescope, fields: Sequence[Field]) -> Real:
    """H_x and H_y of each field, shape (2, field)."""
    return np.array([telescope.relative_field(field) for field in fields]).T


def _is_mirror_symmetric(telescope: Telescope, field: Field) -> bool:
    """Whether the image is the same for x and -x."""
    return telescope.pupil.is_full_annulus and telescope.relative_field(field)[0] == 0.0


def _scaled_hermite(x: Real, rms: float) -> Real:
    """He_n(x; rms^2) for n = 0..MAX_MOMENT, shape (order, *x.shape): He_(n+1) = x He_n - n rms^2 He_(n-1)."""
    out = np.empty((MAX_MOMENT + 1, *x.shape))
    out[0] = 1.0
    out[1] = x
    for n in range(1, MAX_MOMENT):
        out[n + 1] = x * out[n] - n * rms**2 * out[n - 1]
    return out
