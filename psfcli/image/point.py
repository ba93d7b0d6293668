"""The image of one point of the field at one wavelength, with the error it reached (Eq. 44)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from psfcli.image.cells import scattered_in_cells
from psfcli.image.composite import CompositeImage, composite_images
from psfcli.image.ensquared import ensquared_energy, unaberrated_energy
from psfcli.image.geometric import GeometricalImage, geometrical_images
from psfcli.image.grid import Detector
from psfcli.image.narrow_cells import narrow_error, nearest_dark
from psfcli.image.outside import EncircledEnergy, encircled_energy, outside_window
from psfcli.image.result import EnsquaredEnergy, FieldImage, Spot
from psfcli.image.scatter import Halo, scattered_light
from psfcli.image.squares import JudgedSquares, square_response
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Field, Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_REFINEMENT = 10.0  # the estimate comes from a second calculation asked to be this much finer
_TERMS_REFINEMENT = 100.0  # of the mixture, whose terms cost little: by chance it errs as little as one 10 times finer
_PROBE_STEPS = 6
_DIRECTIONS = np.array([(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)])
_RADII = 240
_JUDGED_BOXES = 10
_JUDGED_SHARE = 1e-3  # of the scattered light, where that is less than the energy asked for
_ROUNDING = 1e-12  # of a length: the halo may reach just to the corners of the largest square


@dataclass(frozen=True, slots=True)
class WavelengthScatter:
    """The scattered light at one wavelength: as used, ``finer`` to judge it by, and its energy by another road.

    ``squares`` are the boxes of the ensquared energy. ``energy_error`` is the largest difference between the two in any
    box without aberrations, as a fraction of all light; ``density_error`` holds distances [mm] and how their densities
    differ there, relative.
    """

    halo: Halo
    finer: Halo
    squares: JudgedSquares
    energy_error: float
    density_error: tuple[Real, Real]
    encircled: EncircledEnergy | None


def wavelength_scatter(
    surfaces: Sequence[Surface],
    telescope: Telescope,
    wavelength: float,
    half_width: Real,
    reach: float,
    tolerance: Tolerance,
    *,
    with_cube: bool = True,
) -> WavelengthScatter:
    """What every field at ``wavelength`` [mm] shares: boxes of increasing ``half_width`` [mm] included.

    ``reach`` [mm] bounds the distances asked for. Without a cube nobody asks for the light outside the window.
    """
    halo = scattered_light(surfaces, telescope, wavelength, reach, tolerance)
    finer = scattered_light(surfaces, telescope, wavelength, reach, _finer(tolerance, _TERMS_REFINEMENT))
    rough = halo.mixture.weight.size > 0
    places = slice(0, None, max(1, half_width.size // _JUDGED_BOXES))
    squares = JudgedSquares(
        used=square_response(halo.mixture, half_width, halo.held(half_width)),
        finer=square_response(finer.mixture, half_width[places], finer.held(half_width[places])),
        places=places,
    )
    difference = np.abs(unaberrated_energy(halo, half_width) - unaberrated_energy(finer, half_width))
    return WavelengthScatter(
        halo=halo,
        finer=finer,
        squares=squares,
        energy_error=max(float(difference.max(initial=0.0)), _beyond(finer, half_width)) if rough else 0.0,
        density_error=_density_error(halo, finer, reach) if rough else (np.zeros(1), np.zeros(1)),
        encircled=encircled_energy(surfaces, telescope, wavelength, reach, tolerance) if rough and with_cube else None,
    )


def _beyond(halo: Halo, half_width: Real) -> float:
    """The light that no square holds though some are larger than the ``halo`` reaches."""
    largest = half_width[-1:]
    beyond = halo.held(largest) < (1.0 - _ROUNDING) * largest
    return float(np.max(np.abs(1.0 - unaberrated_energy(halo, largest)), where=beyond, initial=0.0))


def field_images(
    telescope: Telescope,
    fields: Sequence[Field],
    scatter: WavelengthScatter,
    detector: Detector,
    tolerance: Tolerance,
    *,
    with_cube: bool,
) -> Iterator[FieldImage]:
    """The images of ``fields``: ensquared energy, errors reached and, ``with_cube``, pixels and the light outside."""
    points = geometrical_images(telescope, fields)
    whole = float(np.abs(scatter.finer.mixture.weight).sum())
    finer = min(tolerance.ee / _REFINEMENT, _JUDGED_SHARE * whole)
    energies = ensquared_energy(points, scatter.halo, scatter.squares, tolerance, finer)
    images = composite_images(points, scatter.halo, detector, tolerance) if with_cube else [None] * len(points)
    for point, image, (ensquared, error, difference) in zip(points, images, energies, strict=True):
        error += max(difference, scatter.energy_error)
        yield _field_image(point, image, ensquared, error, scatter, detector, tolerance)


def _field_image(
    point: GeometricalImage,
    image: CompositeImage | None,
    ensquared: EnsquaredEnergy,
    ee_error: float,
    scatter: WavelengthScatter,
    detector: Detector,
    tolerance: Tolerance,
) -> FieldImage:
    """The image of one point, whose ensquared energy and its error are known, as are its pixels if asked for."""
    halo = scatter.halo
    psf = psf_over = outside = None
    pixel_error = 0.0
    ee_error += halo.left_energy + halo.collapse_error(float(scatter.squares.used.half_width.min(initial=math.inf)))
    if image is not None:
        fine = image.light
        farthest = _farthest(point.spot, detector)
        pixel_error = halo.hidden_error(farthest) + halo.collapse_error(detector.sub_pixel)
        radius, difference = scatter.density_error
        pixel_error += float(np.max(difference, where=radius <= farthest, initial=0.0))  # no blur makes it larger
        pixel_error += _probed_error(image, point, scatter, detector, tolerance)
        pixel_error += image.unresolved
        if float(fine.min()) < 0.0:  # only where the ripples of the horizon are all there is
            pixel_error = max(pixel_error, 1.0)
            np.maximum(fine, 0.0, out=fine)
        if image.error > tolerance.ee:
            pixel_error += (image.error - tolerance.ee) / float(fine.max())
        n, m = detector.pixels, detector.oversample
        psf = fine if m == 1 else fine.reshape(n, m, n, m).sum(axis=(1, 3))
        psf_over = None if m == 1 else fine
        outside = outside_window(point, halo, scatter.encircled, detector, tolerance)
        # inside and outside come by different roads: what they lack together is an error of one of them
        ee_error = max(ee_error, abs(1.0 - outside - float(psf.sum())))
    return FieldImage(
        psf=psf,
        psf_over=psf_over,
        spot=point.spot,
        ensquared=ensquared,
        power_outside=outside,
        reached=Tolerance(pixel_error, ee_error),
    )


def _farthest(spot: Spot, detector: Detector) -> float:
    """The distance from any ray of the spot to any place in the window, or a little more [mm]."""
    x_start, x_stop, y_start, y_stop = detector.bounds()
    return math.hypot(
        max(x_stop - spot.x_min, spot.x_max - x_start),
        max(y_stop - spot.y_min, spot.y_max - y_start),
    )


def _density_error(halo: Halo, finer: Halo, reach: float) -> tuple[Real, Real]:
    """Distances [mm] from the core to ``reach`` and how the two densities differ there, relative."""
    core = math.sqrt(float(finer.mixture.variance.min()))
    r = np.append(0.0, np.geomspace(min(0.1 * core, reach), reach, _RADII))
    truth = finer.mixture.density(r)
    lit = truth > 0.0
    return r[lit], np.abs(halo.mixture.density(r)[lit] / truth[lit] - 1.0)


def _finer(tolerance: Tolerance, factor: float) -> Tolerance:
    return Tolerance(tolerance.pixel / factor, tolerance.ee / factor)


def _probed_error(
    image: CompositeImage, point: GeometricalImage, scatter: WavelengthScatter, detector: Detector, tolerance: Tolerance
) -> float:
    """Largest relative error of the blur, beyond the allowance, at pixels and sub-pixels ever farther from the spot.

    In eight directions, to the very edges and corners. What sub-pixels are allowed each may add up in a pixel.
    """
    mixture = scatter.halo.mixture
    if mixture.weight.size == 0:
        return 0.0
    centroid = point.spot.centroid_y, point.spot.centroid_x
    asked, weight = _finer(tolerance, _REFINEMENT), scatter.halo.unscattered_weight
    probes = []
    for oversample in {1, detector.oversample}:
        n, width = detector.sub_pixels // oversample, oversample * detector.sub_pixel
        under = (centroid - np.array([detector.start(1), detector.start(0)])) / width  # the pixel nearest the spot
        nearest = np.clip(under, 0, n - 1).astype(np.intp)
        room = np.where(_DIRECTIONS > 0, n - 1 - nearest, nearest)
        step = np.geomspace(1.0, 1.0 + room, _PROBE_STEPS).astype(np.intp) - 1
        y, x = np.unique((nearest + step * _DIRECTIONS).reshape(-1, 2), axis=0).T
        probes.append(
            (
                detector.edges(0)[oversample * x] + 0.5 * width,
                detector.edges(1)[oversample * y] + 0.5 * width,
                np.full(x.size, width),
                np.where(image.touched(y, x, oversample) & (weight > 0.0), tolerance.ee, 0.0),
                weight * image.unscattered_in(y, x, oversample),
                image.light.reshape(n, oversample, n, oversample)[y, :, x].sum(axis=(1, 2)),
            )
        )
    centre_x, centre_y, width, allowance, unscattered, light = np.concatenate(probes, axis=1)
    brightest = min(detector.oversample**2 * float(image.unscattered.max(initial=0.0)) + image.beside, 1.0)
    truth = unscattered + scattered_in_cells(
        point,
        mixture,
        centre_x,
        centre_y,
        width,
        asked,
        narrow_error(mixture, asked, nearest_dark(point, detector), brightest),
        allowance / _REFINEMENT,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.maximum(np.abs(light - truth) - allowance, 0.0) / truth
    return float(np.max(error, where=truth > 0.0, initial=0.0))
