"""Ensquared energy against the half width of the square."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

MOST_NAMED = 8
"""Curves named in the legend; of more, the first and the last."""
_STYLES = "-", "--", "-.", (0, (5, 1, 1, 1, 1, 1))
_MAP, _LIGHTEST = "viridis", 0.75  # its lightness grows throughout: readable in grey


@dataclass(frozen=True, slots=True)
class EnergyCurve:
    """Fractions of all light ``energy`` in squares of ``half_width`` [um], increasing, both of shape [square]."""

    label: str
    half_width: Real
    energy: Real


def energy_panel(
    axes: Any, curves: Sequence[EnergyCurve], unaberrated: EnergyCurve | None = None, pixel: float | None = None
) -> list[Any]:
    """Draw ``curves`` on matplotlib ``axes``, with a dotted one without aberrations; their lines come back, in order.

    ``pixel`` [um]: the square that is one pixel is marked. What else is drawn by the colours of the lines, such as
    points to compare, is for the caller, and so is the legend once it stands.
    """
    import matplotlib as mpl

    colours = mpl.colormaps[_MAP](np.linspace(0.0, _LIGHTEST, len(curves)))
    if unaberrated:
        axes.plot(unaberrated.half_width, unaberrated.energy, color="0.45", ls=":", label=unaberrated.label)
    lines = []
    for i, (curve, colour, style) in enumerate(zip(curves, colours, cycle(_STYLES), strict=False)):
        named = len(curves) <= MOST_NAMED or i in (0, len(curves) - 1)
        label = curve.label if named else None
        lines += axes.plot(curve.half_width, curve.energy, color=colour, ls=style, label=label)
    axes.set(
        xscale="log",
        xlabel="half width about the Gaussian image point  [µm]",
        ylabel="fraction of all light",
        ylim=(0.0, 1.02),
    )
    axes.autoscale(axis="x", tight=True)
    if pixel is not None:
        axes.axvline(0.5 * pixel, color="0.6", lw=0.6, zorder=0.5)
        axes.annotate("1 pixel", (0.5 * pixel, 0.03), (3, 0), textcoords="offset points", color="0.4", fontsize=7.5)
    return lines
