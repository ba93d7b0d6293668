"""The composite image as one would compute it otherwise: a product of transforms on a periodic grid [mm]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from psfcli.image.grid import Detector
from psfcli.planning.plan import Plan
from psfcli.surface.harvey_shack import surface_transfer_function
from psfcli.tradeoff.rays import counted, pupil_grid

Real = NDArray[np.float64]

_RAYS = 1 << 20  # of the geometrical image
_TABLE = 4000  # radii at which the transfer function is computed; between them it is interpolated


def plain_fft(scene: Plan, size: int, blur: Real | None = None) -> tuple[Real, Real]:
    """Eq. 44 by rfft2 on ``size`` x ``size`` sub-pixels: energies of the detector's pixels [y, x] and of the boxes.

    Unscattered rays are counted where they land. For the scatter, they are counted in the cells of the grid and
    multiplied, in the transform, by the transfer function and the blur of a cell. The image repeats with the grid's
    period, and so do the wings. A box takes its part of each cell's scattered light: valid for boxes within the window.
    ``blur`` is what ``scattered_blur`` gives, for fields that share it.
    """
    detector = scene.detector
    cell = detector.sub_pixel
    unscattered = counted(pupil_grid(scene, _RAYS), detector, scene.half_widths)
    spot = np.zeros(size * size)
    rays = 0
    for x, y in pupil_grid(scene, _RAYS):
        column = np.floor((x - detector.start(0)) / cell).astype(np.intp) % size
        row = np.floor((y - detector.start(1)) / cell).astype(np.intp) % size
        spot += np.bincount(row * size + column, minlength=spot.size)
        rays += x.size
    spot = spot.reshape(size, size) / rays
    if blur is None:
        blur = scattered_blur(scene, size)
    image = fft.irfft2(fft.rfft2(spot, workers=1) * blur, (size, size), workers=1)
    n, m = detector.pixels, detector.oversample
    scattered = image[: n * m, : n * m]
    pixels, energies = (scene.specular_fractions[0] * part for part in unscattered)
    pixels += scattered.reshape(n, m, n, m).sum(axis=(1, 3))
    return pixels, energies + _energies(scattered, detector, scene.half_widths)


def scattered_blur(scene: Plan, size: int) -> Real:
    """What the transform of a spot on ``size`` x ``size`` sub-pixels is multiplied by: scatter, and blur of a cell."""
    cell = scene.detector.sub_pixel
    fy, fx = fft.fftfreq(size, cell)[:, None], fft.rfftfreq(size, cell)
    blur = _scattered_transfer_function(scene, np.hypot(fx, fy))
    blur *= np.sinc(fx * cell) * np.sinc(fy * cell)
    return blur


def plain_fft_memory(size: int) -> float:
    """What ``plain_fft`` takes [bytes]: spot and image, a transform of either, the transfer function."""
    return 30.0 * size**2


def _scattered_transfer_function(scene: Plan, q: Real) -> Real:
    """OTF_S(q) - exp(-G) [1] at image-plane frequencies ``q`` [cycles/mm], shape of q, from a table in ln q."""
    wavelength = scene.wavelengths[0]
    lowest = float(q[q > 0.0].min())
    table = np.geomspace(lowest, float(q.max()), _TABLE)
    transfer = np.ones_like(table)
    for surface in scene.surfaces:
        d = scene.telescope.magnified_distance(surface.marginal_height)
        transfer *= surface_transfer_function(wavelength * d * table, surface, wavelength)
    found = np.interp(np.log(np.maximum(q, lowest)), np.log(table), transfer)
    found[q == 0.0] = 1.0
    return found - scene.specular_fractions[0]


def _energies(window: Real, detector: Detector, half_width: Real) -> Real:
    """Energies in squares about the Gaussian image point, the light of a cell taken as evenly spread; shape [box]."""
    part = []
    for axis in (0, 1):
        edges = detector.edges(axis)
        overlap = np.minimum(edges[1:], half_width[:, None]) - np.maximum(edges[:-1], -half_width[:, None])
        part.append(np.maximum(overlap, 0.0) / detector.sub_pixel)
    energy: Real = np.sum((part[1] @ window) * part[0], axis=1)
    return energy
