"""A run on one sheet, in the manner of the paper's Figs. 8 to 10: images of a point, and ensquared energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from psfcli.pictures.canvas import sheet
from psfcli.pictures.energy import EnergyCurve, energy_panel
from psfcli.pictures.psf import colour_bar, decades, density, psf_panel

Real = NDArray[np.float64]

_PANEL = 3.3  # inches


@dataclass(frozen=True, slots=True)
class Window:
    """A part of an image: the ``fraction`` [y, x] of all light in cells between the edges ``x`` and ``y`` [um].

    From the Gaussian image point; ``pixel`` [um] is the width of a detector pixel.
    """

    label: str
    fraction: Real
    x: Real
    y: Real
    pixel: float


@dataclass(frozen=True, slots=True)
class Row:
    """What is drawn of one wavelength: ``windows`` of one image, and the energies of all fields."""

    label: str
    windows: tuple[Window, ...]
    curves: tuple[EnergyCurve, ...]
    unaberrated: EnergyCurve
    pixel: float


def draw(stream: BinaryIO, title: str, rows: Sequence[Row]) -> None:
    """Write the sheet as PNG, a row for each wavelength, all with the same number of windows.

    The windows of a row share their colours. Raises ImportError where matplotlib is missing.
    """
    images = len(rows[0].windows)
    width, height = (1.0 * (images > 0) + _PANEL * (images + 1.3)), _PANEL * len(rows)
    with sheet(stream, width, height + 0.3, colours=None) as figure:
        axes = figure.subplots(len(rows), images + 1, squeeze=False, width_ratios=[*[1.0] * images, 1.3])
        for panels, row in zip(axes, rows, strict=True):
            if images:
                _images(figure, panels[:-1], row)
            energy_panel(panels[-1], row.curves, row.unaberrated, row.pixel)
            panels[-1].legend(loc="lower right")
            panels[-1].set_title(f"{row.label}: ensquared energy", loc="left")
        figure.suptitle(title, fontsize=10)
        figure.get_layout_engine().set(wspace=0.05)


def _images(figure: Any, panels: Sequence[Any], row: Row) -> None:
    limits = decades(density(window.fraction, window.x, window.y) for window in row.windows)
    drawn: list[Any] = []
    for panel, window in zip(panels, row.windows, strict=True):
        drawn.append(psf_panel(panel, window.fraction, window.x, window.y, limits, window.pixel))
        panel.set_title(f"{row.label}, {window.label}", loc="left")
        panel.set_ylabel("" if drawn[1:] else "y  [µm]")
    colour_bar(figure, drawn)
