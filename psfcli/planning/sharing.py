"""Which images are computed, and which others each of them stands for.

An image is the same to the last bit but for rounding, turned or mirrored,

- for fields that no aberration tells apart: without W131, W222, W220 and W311 all of them, without W131, W222 and W311
  all at one distance from the axis;
- on a full annulus, for fields that a symmetry of the square maps onto each other, if it maps the detector's grid onto
  itself (squares of ensquared energy it always does);
- for wavelengths at which nothing scatters.

What is computed depends on the field alone and not on the others asked for: a sweep in parts gives the numbers of the
whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from psfcli.image.grid import Detector
from psfcli.image.symmetry import SYMMETRIES, Symmetry
from psfcli.telescope.system import Field, Telescope

_UP = 0.5 * math.pi  # the azimuth of plain fields: their images are mirror-symmetric, and cost least
_DIGITS = 12  # of an azimuth [rad]: what agrees to so many is the same


@dataclass(frozen=True, slots=True)
class Twin:
    """An image asked for, by its indices, and the symmetry that makes it of the image computed."""

    wavelength_index: int
    field_index: int
    symmetry: Symmetry


@dataclass(frozen=True, slots=True)
class Computation:
    """An image that is computed, of ``field`` at one wavelength, and the images it stands for, the first its own."""

    wavelength_index: int
    field: Field
    stands_for: tuple[Twin, ...]


def each_by_itself(fields: Sequence[Field], wavelengths: int) -> tuple[Computation, ...]:
    """Every image asked for computed as it is asked for."""
    return tuple(
        Computation(w, field, (Twin(w, f, Symmetry()),)) for w in range(wavelengths) for f, field in enumerate(fields)
    )


def shared_computations(
    telescope: Telescope,
    fields: Sequence[Field],
    scatters: Sequence[bool],
    detector: Detector | None,
) -> tuple[Computation, ...]:
    """The images to compute, by wavelength and first field.

    ``scatters`` tells for each wavelength whether anything scatters; ``detector`` None: no pixels are asked for.
    """
    symmetries = [s for s in SYMMETRIES if detector is None or s.keeps(detector)]
    smooth = scatters.index(False) if False in scatters else -1
    twins: dict[tuple[int, Field], list[Twin]] = {}
    for w, rough in enumerate(scatters):
        for f, field in enumerate(fields):
            computed, symmetry = representative(telescope, field, symmetries)
            twins.setdefault((w if rough else smooth, computed), []).append(Twin(w, f, symmetry))
    return tuple(Computation(w, field, tuple(images)) for (w, field), images in sorted(twins.items(), key=_first))


def representative(telescope: Telescope, field: Field, symmetries: Sequence[Symmetry]) -> tuple[Field, Symmetry]:
    """The field whose image is computed, and the symmetry that turns that image into the one of ``field``.

    Of all fields with the same image but for one of the ``symmetries`` (a group), that nearest to +y.
    """
    W = telescope.seidel
    if not (W.W131 or W.W222 or W.W220 or W.W311) or field.radius == 0.0:
        return Field(0.0, _UP), Symmetry()
    if not (W.W131 or W.W222 or W.W311):
        return Field(abs(field.radius), _UP), Symmetry()
    if not telescope.pupil.is_full_annulus:
        return field, Symmetry()
    azimuth = field.azimuth + (math.pi if field.radius < 0.0 else 0.0)
    from_up, symmetry = min(_candidates(azimuth, symmetries), key=lambda c: (abs(c[0]), c[0] > 0.0))
    return Field(abs(field.radius), _UP + from_up), symmetry.inverse


def _candidates(azimuth: float, symmetries: Sequence[Symmetry]) -> Iterator[tuple[float, Symmetry]]:
    """How far from +y each symmetry takes the azimuth [rad], rounded, so that equals are equal."""
    for symmetry in symmetries:
        yield round(math.remainder(symmetry.azimuth(azimuth) - _UP, 2.0 * math.pi), _DIGITS) + 0.0, symmetry


def _first(entry: tuple[tuple[int, Field], list[Twin]]) -> tuple[int, int]:
    (wavelength_index, _), images = entry
    return wavelength_index, images[0].field_index
