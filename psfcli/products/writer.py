"""All products of a run, written while the images come: the memory of one field, however many there are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from psfcli.products.atomic import Stage, output_errors
from psfcli.products.header import ImageSummary
from psfcli.products.manifest import manifest
from psfcli.products.tables import CsvProduct, ensquared_rows
from psfcli.products.target import EE_TABLE, FITS, FORMATS, MANIFEST, check_room, check_target, cube_bytes, products_in

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import TracebackType

    from psfcli.image.result import FieldImage
    from psfcli.products.exr import ExrProduct
    from psfcli.products.fits import FitsProduct
    from psfcli.products.header import RunHeader


class ProductWriter:
    """Writes the products of a run into ``directory``; a context manager.

    ``add`` every image once, in any order. Leaving the ``with`` normally puts all products in place,
    the manifest last; leaving it by an exception removes what was written and touches nothing that stood there.
    Only ``overwrite`` allows a directory that holds anything; it replaces and removes products of ours alone.

    ``paths`` are the files written and ``notes`` remarks for the user, both once the ``with`` is left;
    ``timings`` [s] goes into the manifest. Raises OutputError, on construction when ``directory`` is refused.
    """

    def __init__(
        self, directory: Path, header: RunHeader, formats: Sequence[str] = FORMATS, *, overwrite: bool = False
    ) -> None:
        with output_errors(directory):
            check_target(directory, overwrite=overwrite)
        images = len(header.fields) * len(header.wavelengths)
        check_room(directory, cube_bytes(header.detector, images, formats))
        self._directory = directory
        self._header = header
        self._formats = tuple(formats)
        self._summaries: list[ImageSummary] = []
        self._fits: FitsProduct | None = None
        self._exr: ExrProduct | None = None
        self._csv: CsvProduct | None = None
        self.timings: dict[str, float] = {}
        self.paths: tuple[Path, ...] = ()
        self.notes: tuple[str, ...] = ()

    def __enter__(self) -> ProductWriter:
        """Make the directory and open the temporaries."""
        with output_errors(self._directory):
            self._stage = Stage(self._directory)
            try:
                self._open()
            except BaseException:
                self._stage.close()
                raise
        return self

    def add(self, wavelength_index: int, field_index: int, image: FieldImage) -> None:
        """Write one image; nothing of its planes is kept."""
        with output_errors(self._directory):
            for product in (self._fits, self._exr, self._csv):
                if product is not None:
                    product.add(wavelength_index, field_index, image)
        self._summaries.append(ImageSummary.of(wavelength_index, field_index, image))

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Put the products in place, or remove the temporaries after an exception."""
        try:
            if kind is None:
                with output_errors(self._directory):
                    self._finish()
        finally:
            self._stage.close()

    def _open(self) -> None:
        # imported where asked for: astropy.io.fits and OpenEXR take as long to load as a small run
        if "fits" in self._formats:
            from psfcli.products.fits import FitsProduct

            self._fits = FitsProduct(self._stage.open(FITS), self._header)
        if "exr" in self._formats:
            from psfcli.products.exr import ExrProduct

            self._exr = ExrProduct(self._stage, self._header)
        if "csv" in self._formats:
            self._csv = CsvProduct(self._stage.open(EE_TABLE), self._header)

    def _finish(self) -> None:
        announced = len(self._header.wavelengths) * len(self._header.fields)
        added = {(summary.wavelength_index, summary.field_index) for summary in self._summaries}
        if not len(added) == len(self._summaries) == announced:
            raise ValueError(
                f"{len(self._summaries)} images were added ({len(added)} different), {announced} announced"
            )
        if self._fits is not None:
            self._fits.finish(self._summaries, ensquared_rows(self._header, self._summaries))
            self._stage.seal(FITS)
        if self._exr is not None:
            note = self._exr.finish()
            self.notes = (note,) if note else ()
        digests = self._stage.digests()
        names = [*digests, MANIFEST]
        obsolete = [name for name in products_in(self._directory) if name not in names]
        self._stage.commit(MANIFEST, manifest(self._header, digests, self.timings), obsolete)
        self.paths = tuple(self._directory / name for name in names)
