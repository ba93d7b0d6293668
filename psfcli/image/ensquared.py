"""Ensquared energy: fractions of all light in squares about a point of the image [mm]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.image.composite import allowed_error
from psfcli.image.expansion import (
    interval_integrals,
    normal_probability,
    orders_needed,
    quasi_moments,
    ray_spacing,
)
from psfcli.image.geometric import nodes_for_spacing, ray_bundle
from psfcli.image.result import EnsquaredEnergy, Spot
from psfcli.image.scatter import Halo
from psfcli.image.unscattered import unscattered_in_boxes
from psfcli.surface.mixture import GaussianMixture
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_RAYS_AT_ONCE = 4096
_TAIL = 8.5  # widths beyond which less than 1e-17 of a Gaussian lies


def default_half_widths(pixel: float, pixels: int) -> Real:
    """Half widths [mm]: ten per decade from 0.01 to 1000 pixels, and every whole-pixel box up to the window, increasing."""
    decades = 10.0 ** np.linspace(-2.0, 3.0, 51)
    whole = 0.5 * np.arange(1, pixels + 1)
    return pixel * np.unique(np.round(np.concatenate([decades, whole]), 12))


def unaberrated_energy(halo: Halo, half_width: Real) -> Real:
    """Ensquared energy without aberrations, the specular point included: shape of ``half_width``."""
    side = normal_probability(*_about(0.0, half_width[:, None] / np.sqrt(halo.mixture.variance)))
    return halo.specular_fraction + side**2 @ halo.mixture.weight


def ensquared_energy(
    telescope: Telescope,
    field: Field,
    halo: Halo,
    spot: Spot,
    half_width: Real,
    tolerance: Tolerance,
    azimuths: int,
) -> tuple[EnsquaredEnergy, float]:
    """Energies in squares of increasing ``half_width`` about the Gaussian image point, the chief ray and the centroid,

    and the estimated error of the unscattered share, in fractions of all light. ``azimuths``: a multiple of 3.
    """
    centres = [(0.0, 0.0), (spot.chief_x, spot.chief_y), (spot.centroid_x, spot.centroid_y)]
    distinct = list(dict.fromkeys(centres))
    scattered = _scattered_in_boxes(telescope, field, halo.mixture, spot, distinct, half_width, tolerance)
    energy, error = {}, 0.0
    for centre, share in zip(distinct, scattered, strict=True):
        unscattered, its_error = unscattered_in_boxes(telescope, field, centre, half_width, azimuths)
        energy[centre] = share + halo.specular_fraction * unscattered
        error = max(error, halo.specular_fraction * its_error)
    about = [energy[centre] for centre in centres]
    return EnsquaredEnergy(half_width, *about, unaberrated_energy(halo, half_width)), error


def _about(offset: float | Real, half_width: Real) -> tuple[Real, Real]:
    return offset - half_width, offset + half_width


def _scattered_in_boxes(
    telescope: Telescope,
    field: Field,
    mixture: GaussianMixture,
    spot: Spot,
    centres: list[tuple[float, float]],
    half_width: Real,
    tolerance: Tolerance,
) -> list[Real]:
    """Scattered light, as fractions of all light, in boxes about each of the centres: arrays of shape [box]."""
    if mixture.weight.size == 0:
        return [np.zeros_like(half_width) for _ in centres]
    moments = quasi_moments(telescope, field, spot)
    order = orders_needed(moments, mixture.variance, spot, allowed_error(mixture, Tolerance(1.0, tolerance.ee)))
    wide = order >= 0
    energy = _by_moments(
        GaussianMixture(mixture.weight[wide], mixture.variance[wide]),
        moments,
        int(order.max(initial=0)),
        spot,
        centres,
        half_width,
    )
    spacing = ray_spacing(np.sqrt(mixture.variance), mixture.weight, 0.1 * tolerance.ee / mixture.weight.size)
    for k in np.flatnonzero(~wide):
        rays = ray_bundle(telescope, field, *nodes_for_spacing(telescope, field, float(spacing[k])))
        width = float(mixture.variance[k]) ** 0.5
        for total, centre in zip(energy, centres, strict=True):
            x, y = np.abs(rays.x - centre[0]), np.abs(rays.y - centre[1])
            full = half_width > max(x.max(), y.max()) + _TAIL * width
            box = half_width[~full, None] / width
            inside = np.zeros(box.shape[0])
            for first in range(0, x.size, _RAYS_AT_ONCE):
                part = slice(first, first + _RAYS_AT_ONCE)
                in_x = normal_probability(*_about(x[part] / width, box))
                in_y = normal_probability(*_about(y[part] / width, box))
                inside += (in_x * in_y) @ rays.share[part]
            total[full] += mixture.weight[k]
            total[~full] += mixture.weight[k] * inside
    return energy


def _by_moments(
    mixture: GaussianMixture,
    moments: Real,
    order: int,
    spot: Spot,
    centres: list[tuple[float, float]],
    half_width: Real,
) -> list[Real]:
    Q = moments[: order + 1, : order + 1]
    energy = []
    for centre in centres:
        x = interval_integrals(*_about(centre[0] - spot.centroid_x, half_width), mixture.variance + spot.rms_x**2, order)
        y = interval_integrals(*_about(centre[1] - spot.centroid_y, half_width), mixture.variance + spot.rms_y**2, order)
        energy.append(mixture.weight @ np.sum(x * np.tensordot(Q, y, axes=1), axis=0))
    return energy
