"""How long the products of a run take to write, from writing one image in earnest and throwing it away."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from psfcli.products.writer import ProductWriter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from psfcli.image.result import FieldImage
    from psfcli.products.header import RunHeader

_PIXELS = 256  # of the corner written: larger images take longer in proportion
_MORE = 8  # images written to see what each takes


def writing_seconds(header: RunHeader, formats: Sequence[str], image: FieldImage) -> float:
    """The time [s] it takes to load the libraries of ``formats`` and write every image of a run, all like ``image``.

    Written to a temporary directory, of which nothing stays. Raises OSError or OutputError where there is no room.
    """
    some = min(header.detector.pixels, _PIXELS)
    larger = (header.detector.pixels / some) ** 2 if image.psf is not None else 1.0
    corner = replace(
        image,
        psf=_corner(image.psf, some),
        psf_over=_corner(image.psf_over, some * header.detector.oversample),
    )
    with tempfile.TemporaryDirectory(prefix="psfcli_") as place:

        def written(number: int, images: int) -> float:
            """The time to write ``images`` of one wavelength as the ``number``-th run."""
            small = replace(
                header,
                wavelengths=header.wavelengths[:1],
                specular_fractions=header.specular_fractions[:1],
                fields=header.fields[:1] * images,
                detector=replace(header.detector, pixels=some),
            )
            started = time.perf_counter()
            with ProductWriter(Path(place) / str(number), small, formats) as products:
                for index in range(images):
                    products.add(0, index, corner)
            return time.perf_counter() - started

        first, one, more = written(0, 1), written(1, 1), written(2, 1 + _MORE)
    each = max(more - one, 0.0) / _MORE
    return first + each * (larger * len(header.wavelengths) * len(header.fields) - 1.0)


def _corner(plane: NDArray[np.float64] | None, edge: int) -> NDArray[np.float64] | None:
    return None if plane is None else np.ascontiguousarray(plane[:edge, :edge])
