"""A fit as a picture, in the manner of the paper's Fig. 6: the spectra measured, the fit and its terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np

from psfcli.metrology.fit import Fit
from psfcli.metrology.measurement import KINDS, ONE_SIDED, TWO_DIMENSIONAL
from psfcli.metrology.spectrum import log_density
from psfcli.pictures.canvas import sheet
from psfcli.products.units import NM

_MARKS = "osD^v<>ph*"
_POINTS = 400
_RATIOS = 0.1, 0.3, 1.0, 3.0, 10.0
_AXIS = {
    ONE_SIDED: "one-sided 1-D PSD  [nm² mm]",
    TWO_DIMENSIONAL: "2-D PSD  [nm² mm²]",
}


def draw(stream: BinaryIO, fit: Fit, image_bands: Sequence[tuple[float, float]] = ()) -> None:
    """Write the picture as PNG: spectra as measured above, measured over fitted below.

    Where all are one-dimensional, one-sided spectra are drawn, otherwise two-dimensional ones; a spectrum of another
    kind is drawn at the same ratio to the fit. ``image_bands`` [cycles/mm], which an image uses, are shaded. Raises
    ImportError where matplotlib is missing.
    """
    measured = [one.measurement for one in fit.instruments]
    kind = TWO_DIMENSIONAL if any(m.kind == TWO_DIMENSIONAL for m in measured) else ONE_SIDED
    edges = [f for band in (*(m.band for m in measured), *image_bands) for f in band]
    grid = np.geomspace(min(edges) / 2.0, max(edges) * 2.0, _POINTS)
    with sheet(stream, 7.2, 6.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        for i, one in enumerate(fit.instruments):
            m, look = one.measurement, {"color": f"C{i % 10}", "marker": _MARKS[i % len(_MARKS)]}
            f = np.array(m.frequency)
            ratio = np.array(m.density) / np.exp(one.log_fit)
            label = f"{m.name} ({m.kind})"
            for axis, values in ((upper, _density(f, kind, fit.parameters) * ratio), (lower, ratio)):
                axis.plot(f, values, ls="", ms=3.5, mfc="none", mew=0.8, label=label, **look)
        if len(fit.parameters) > 1:
            for j, term in enumerate(fit.parameters):
                upper.plot(grid, _density(grid, kind, term[None]), "k--", lw=0.9, label="" if j else "its terms")
        upper.plot(grid, _density(grid, kind, fit.parameters), "k", lw=1.4, label="K-correlation")
        lower.axhline(1.0, color="k", lw=1.4)
        _limits(upper, fit, kind, grid)
        for band in image_bands:
            for axis in (upper, lower):
                axis.axvspan(*band, color="0.5", alpha=0.12, lw=0)
        if image_bands:
            upper.plot([], [], color="0.5", alpha=0.3, lw=6, label="used by the image")
        upper.set(xscale="log", yscale="log", ylabel=_AXIS[kind])
        lower.set(yscale="log", yticks=_RATIOS, yticklabels=[f"{ratio:g}" for ratio in _RATIOS])
        lower.minorticks_off()
        lower.set(xlabel="spatial frequency  [cycles/mm]", ylabel="measured / fitted")
        lower.set_xlim(grid[0], grid[-1])
        upper.legend(loc="lower left", fontsize=8)


def _density(f: Any, kind: str, terms: Any) -> Any:
    """The spectrum [nm^2 mm or nm^2 mm^2] at frequencies [cycles/mm]."""
    return NM**2 * np.exp(log_density(f, np.full(f.size, KINDS.index(kind)), terms)[0])


def _limits(axis: Any, fit: Fit, kind: str, grid: Any) -> None:
    """The range of the whole fit, so that terms far below it do not stretch the axis."""
    whole = _density(grid, kind, fit.parameters)
    axis.set_ylim(whole.min() / 3.0, whole.max() * 10.0)
