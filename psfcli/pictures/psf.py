"""The image of a point on cells of the detector: colours over decades, with contours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

MOST_DECADES = 6
"""Decades of density that colours span; what is fainter has the darkest of them."""
_CONTOURS_PER_DECADE = 2
_MAP = "inferno"  # its lightness grows throughout: readable in grey


def density(fraction: Real, x: Real, y: Real) -> Real:
    """The fraction of all light per mm^2 in cells [y, x] that hold ``fraction``, between edges ``x`` and ``y`` [um]."""
    return fraction / (1e-6 * np.outer(np.diff(y), np.diff(x)))


def decades(densities: Iterable[Real]) -> tuple[float, float]:
    """Limits [1/mm^2] for panels that share their colours: whole decades about all ``densities`` above 0.

    The topmost MOST_DECADES of them, at least one; 0.1 to 1 where no density is above 0.
    """
    lit = [shown[shown > 0.0] for shown in densities]
    most = math.ceil(math.log10(max(float(each.max(initial=0.0)) for each in lit) or 1.0))
    least = math.floor(math.log10(min(float(each.min(initial=10.0**most)) for each in lit)))
    return 10.0 ** min(max(least, most - MOST_DECADES), most - 1), 10.0**most


def psf_panel(axes: Any, fraction: Real, x: Real, y: Real, limits: tuple[float, float], pixel: float) -> Any:
    """Draw the image of a point on matplotlib ``axes``; what ``colour_bar`` needs comes back.

    ``fraction`` [y, x] is the share of all light in each cell, ``x`` and ``y`` the edges of the cells [um], evenly
    spaced, from the Gaussian image point. Shown is its density, in colours between ``limits`` [1/mm^2], with contours
    at every decade and half-way. ``pixel`` [um] is the width of the detector's pixels, whose grid starts at the edges.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import MaxNLocator

    shown = density(fraction, x, y)
    drawn = axes.imshow(
        np.maximum(shown, limits[0]),  # a logarithm of nothing has no colour
        norm=LogNorm(*limits),
        cmap=_MAP,
        origin="lower",
        extent=(x[0], x[-1], y[0], y[-1]),
        interpolation="nearest",
    )
    axes.grid(visible=False)
    for draw, edges in ((axes.axvline, x), (axes.axhline, y)):
        for edge in np.arange(edges[0] + pixel, edges[-1] - 0.5 * pixel, pixel):
            draw(edge, color="white", lw=0.3, alpha=0.3)
    _contours(axes, shown, x, y, limits)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    axes.set(xlabel="x  [µm]", ylabel="y  [µm]")
    return drawn


def _contours(axes: Any, shown: Real, x: Real, y: Real, limits: tuple[float, float]) -> None:
    """Lines of equal density between the centres of the cells, if any."""
    least, most = (round(math.log10(limit)) for limit in limits)
    levels = 10.0 ** np.linspace(least, most, 1 + _CONTOURS_PER_DECADE * (most - least))[1:-1]
    crossed = levels[(levels > shown.min()) & (levels < shown.max())]
    if crossed.size and min(shown.shape) > 1:
        middle = (0.5 * (edges[1:] + edges[:-1]) for edges in (x, y))
        axes.contour(*middle, shown, crossed, colors="white", linewidths=0.5, alpha=0.7)


def colour_bar(figure: Any, drawn: Sequence[Any]) -> None:
    """Draw the colours that the panels ``drawn`` share beside them, pointed where cells are fainter."""
    faintest = min(float(image.get_array().min()) for image in drawn)
    bar = figure.colorbar(
        drawn[0],
        ax=[image.axes for image in drawn],
        extend="min" if faintest <= drawn[0].norm.vmin else "neither",
        pad=0.015,
        aspect=24,
    )
    bar.set_label("fraction of all light per mm²")
