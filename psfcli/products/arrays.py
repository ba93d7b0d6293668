"""The products as arrays and tables with units, for Python and notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from psfcli.products.header import ImageSummary
from psfcli.products.tables import EE_COLUMNS, ensquared_rows

if TYPE_CHECKING:
    from collections.abc import Iterable

    from astropy.io import fits
    from astropy.table import QTable
    from numpy.typing import NDArray

    from psfcli.image.result import FieldImage
    from psfcli.products.header import RunHeader
    from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class Result:
    """A run in memory.

    ``psf`` [wavelength, field, y, x] is the fraction of all light in each pixel, ``psf_over`` the same on sub-pixels
    (None when oversample is 1); +y is the direction in which the image moves as the field grows.
    """

    header: RunHeader
    psf: NDArray[np.float64]
    psf_over: NDArray[np.float64] | None
    summaries: tuple[ImageSummary, ...]

    @property
    def reached(self) -> tuple[Tolerance, ...]:
        """The estimated errors, one per wavelength and field."""
        return tuple(summary.reached for summary in self.summaries)

    @property
    def ensquared_energy(self) -> QTable:
        """The columns of ee.csv with their units."""
        from psfcli.products.fits_tables import ensquared_header

        rows = np.concatenate(ensquared_rows(self.header, self.summaries))
        columns = rows.view([(name, np.float64) for name in EE_COLUMNS])[:, 0]
        return _with_units(ensquared_header(self.header, len(rows)), columns)

    @property
    def fields(self) -> QTable:
        """The FIELDS table of psf.fits: centroid, chief ray, spot, power in and outside the window."""
        from psfcli.products.fits_tables import fields_table

        return _with_units(*fields_table(self.header, self.summaries))

    @property
    def surfaces(self) -> QTable:
        """The SURFACES table of psf.fits: sigma_rel, g, TIS, d_j."""
        from psfcli.products.fits_tables import surfaces_table

        return _with_units(*surfaces_table(self.header))


def gather(header: RunHeader, images: Iterable[tuple[int, int, FieldImage]]) -> Result:
    """The run in memory, from images that come in any order, each with its cube."""
    n, m = header.detector.pixels, header.detector.oversample
    shape = (len(header.wavelengths), len(header.fields))
    psf = np.empty((*shape, n, n))
    over = None if m == 1 else np.empty((*shape, n * m, n * m))
    summaries = {}
    for wavelength_index, field_index, image in images:
        at = wavelength_index, field_index
        summaries[at] = ImageSummary.of(wavelength_index, field_index, image)
        psf[at] = image.psf
        if over is not None:
            over[at] = image.psf_over
    return Result(header, psf, over, tuple(summaries[at] for at in sorted(summaries)))


def _with_units(header: fits.Header, rows: NDArray[Any]) -> QTable:
    from astropy import units
    from astropy.table import QTable

    table = QTable()
    for number, name in enumerate(rows.dtype.names or (), start=1):
        unit = header.get(f"TUNIT{number}")
        column = rows[name].astype(str if rows[name].dtype.kind == "S" else rows[name].dtype.newbyteorder("="))
        table[name] = column * units.Unit(unit) if unit else column
    return table
