"""The image of one point of the field at one wavelength, with the error it reached (Eq. 44)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.composite import add_unscattered, scattered_image
from psfcli.image.ensquared import ensquared_energy
from psfcli.image.geometric import spot_statistics
from psfcli.image.grid import Detector
from psfcli.image.outside import EncircledEnergy, encircled_energy, outside_window
from psfcli.image.rectangle import Rectangles, scattered_in_rectangles
from psfcli.image.result import FieldImage, Spot
from psfcli.image.scatter import Halo, scattered_light
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_REFINEMENT = 10.0  # the estimate comes from a second calculation asked to be this much finer
_PROBE_STEPS = 12


@dataclass(frozen=True, slots=True)
class WavelengthScatter:
    """The scattered light at one wavelength: as used, ``finer`` to judge it by, and its encircled energy by another road."""

    halo: Halo
    finer: Halo
    encircled: EncircledEnergy | None


def wavelength_scatter(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, reach: float, tolerance: Tolerance
) -> WavelengthScatter:
    """What every field at ``wavelength`` [mm] shares; ``reach`` [mm] bounds the distances asked for."""
    halo = scattered_light(surfaces, telescope, wavelength, reach, tolerance)
    finer = scattered_light(surfaces, telescope, wavelength, reach, _finer(tolerance))
    rough = halo.mixture.weight.size > 0
    return WavelengthScatter(halo, finer, encircled_energy(surfaces, telescope, wavelength) if rough else None)


def field_image(
    telescope: Telescope,
    field: Field,
    scatter: WavelengthScatter,
    detector: Detector,
    half_width: Real,
    tolerance: Tolerance,
    *,
    with_cube: bool,
) -> FieldImage:
    """The image of ``field``: pixels (when ``with_cube``), ensquared energy, light outside, errors reached."""
    spot = spot_statistics(telescope, field)
    psf = psf_over = None
    pixel_error = 0.0
    if with_cube:
        fine = scattered_image(telescope, field, scatter.halo.mixture, spot, detector, tolerance)
        pixel_error = _scatter_error(fine, telescope, field, scatter.finer, spot, detector, tolerance)
        unscattered_error = add_unscattered(
            fine, telescope, field, scatter.halo.specular_fraction, spot, detector, tolerance
        )
        if unscattered_error > tolerance.ee:
            pixel_error += (unscattered_error - tolerance.ee) / float(fine.max())
        n, m = detector.pixels, detector.oversample
        psf = fine if m == 1 else fine.reshape(n, m, n, m).sum(axis=(1, 3))
        psf_over = None if m == 1 else fine
    ensquared, ee_error = ensquared_energy(telescope, field, scatter.halo, spot, half_width, tolerance)
    ee_error += _box_error(telescope, field, scatter, spot, half_width, tolerance)
    return FieldImage(
        psf=psf,
        psf_over=psf_over,
        spot=spot,
        ensquared=ensquared,
        power_outside=outside_window(telescope, field, spot, scatter.halo, scatter.encircled, detector, tolerance),
        reached=Tolerance(pixel_error, ee_error),
    )


def _finer(tolerance: Tolerance) -> Tolerance:
    return Tolerance(tolerance.pixel / _REFINEMENT, tolerance.ee / _REFINEMENT)


def _scatter_error(
    image: Real,
    telescope: Telescope,
    field: Field,
    finer: Halo,
    spot: Spot,
    detector: Detector,
    tolerance: Tolerance,
) -> float:
    """Largest relative error of the scattered light at probe sub-pixels: along axes and diagonals, ever farther out."""
    if finer.mixture.weight.size == 0:
        return 0.0
    n = detector.sub_pixels
    step = np.unique(np.geomspace(1.0, max(n // 2, 1), _PROBE_STEPS).astype(np.intp)) - 1
    column, row = (n // 2 + np.outer((-1, 0, 1), step).ravel() for _ in range(2))
    pairs = np.array([(y, x) for y in row for x in column if y == x or x + y == 2 * (n // 2) or n // 2 in (x, y)])
    pairs = np.unique(np.clip(pairs, 0, n - 1), axis=0)
    edges_x, edges_y = detector.edges(0), detector.edges(1)
    y, x = pairs.T
    probes = Rectangles(edges_x[x], edges_x[x + 1], edges_y[y], edges_y[y + 1])
    truth = scattered_in_rectangles(telescope, field, finer.mixture, spot, probes, _finer(tolerance))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(image[y, x] - truth) / truth
    return float(np.max(error, where=truth > 0.0, initial=0.0))


def _box_error(
    telescope: Telescope,
    field: Field,
    scatter: WavelengthScatter,
    spot: Spot,
    half_width: Real,
    tolerance: Tolerance,
) -> float:
    """Largest error of the scattered energy in every fourth box about the Gaussian image point."""
    boxes = Rectangles.squares((0.0, 0.0), half_width[::4])
    coarse, fine = (
        scattered_in_rectangles(telescope, field, halo.mixture, spot, boxes, Tolerance(1.0, asked.ee))
        for halo, asked in ((scatter.halo, tolerance), (scatter.finer, _finer(tolerance)))
    )
    return float(np.max(np.abs(coarse - fine), initial=0.0))
