"""A validation as a picture, in the manner of Figs. 8-10: energies of both ways, and their difference beneath."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, BinaryIO

import numpy as np

from psfcli.config.model import System
from psfcli.pictures.canvas import sheet
from psfcli.products.units import UM
from psfcli.validation.comparison import Comparison, Criterion
from psfcli.validation.table import name

_LINES = ("-", "--", "-.", ":")  # told apart in grey, too
_MARKS = ("o", "s", "^", "v", "D", "P")
_MOST_FIELDS = 6
_APART = 0.06  # decades between the points drawn of one image


def pictures(
    system: System, comparisons: Sequence[Comparison], criterion: Criterion
) -> dict[str, Callable[[BinaryIO], None]]:
    """How to draw each picture, by file name: one per wavelength, of at most _MOST_FIELDS fields."""
    found: dict[str, Callable[[BinaryIO], None]] = {}
    for w, wavelength in enumerate(system.wavelengths):
        same = [c for c in comparisons if c.wavelength == wavelength]
        shown = [same[i] for i in np.linspace(0, len(same) - 1, min(len(same), _MOST_FIELDS)).round().astype(int)]
        stem = "validation" if len(system.wavelengths) == 1 else f"validation_wave_{w:02d}"
        title = f"{system.title or 'Untitled system'}: {shown[0].estimate.rays:.3g} rays per image"
        found[f"{stem}.png"] = partial(draw, title, [name(c, system) for c in shown], shown, criterion)
    return found


def draw(
    title: str, names: Sequence[str], comparisons: Sequence[Comparison], criterion: Criterion, stream: BinaryIO
) -> None:
    """Write the images of ``comparisons``, called by ``names``, as PNG; boxes about the Gaussian image point.

    Bars are one standard error; differences that agree lie within the grey. Raises ImportError where matplotlib is
    missing.
    """
    with sheet(stream, 6.4, 6.6) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        for n, (label, c) in enumerate(zip(names, comparisons, strict=True)):
            _one(upper, lower, n, label, c)
        widths = UM * comparisons[0].half_width
        allowed = np.max(
            [np.maximum(criterion.deviations * c.standard_error[0], criterion.bound) + c.told for c in comparisons],
            axis=0,
        )
        lower.fill_between(widths, -allowed, allowed, color="0.9", lw=0.0, zorder=0.5)
        lower.axhline(0.0, color="0.4", lw=0.6)
        upper.set(xscale="log", ylim=(-0.02, 1.02), ylabel="ensquared energy")
        lower.set(xlabel="half width of the square  [µm]", ylabel="Monte Carlo - convolution")
        lower.ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
        upper.legend(loc="upper left", fontsize=7.5)
        figure.suptitle(title, fontsize=9.5)


def _one(upper: Any, lower: Any, n: int, label: str, c: Comparison) -> None:
    """Lines by convolution, points with bars by Monte Carlo."""
    colour, mark, line = f"C{n % 10}", _MARKS[n % len(_MARKS)], _LINES[n % len(_LINES)]
    width = UM * c.half_width
    bins = np.floor(np.log10(width) / _APART + 0.3 * n)  # not all images at the same places
    shown = np.flatnonzero(np.append(True, np.diff(bins) > 0.0))
    upper.plot(width, c.convolution[0], color=colour, ls=line, label=label)
    bars = {"fmt": mark, "color": colour, "ms": 3.0, "mfc": "white", "elinewidth": 0.8, "ls": ""}
    upper.errorbar(width[shown], c.estimate.energy[0][shown], c.standard_error[0][shown], **bars)
    lower.errorbar(width[shown], c.difference[0][shown], c.standard_error[0][shown], **bars)
