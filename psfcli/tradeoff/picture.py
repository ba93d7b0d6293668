"""The tradeoff as a picture: error against time, one line per method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, BinaryIO

from psfcli.pictures.canvas import sheet
from psfcli.tolerance import PRESETS
from psfcli.tradeoff.ladder import OURS
from psfcli.tradeoff.measurement import Measurement
from psfcli.tradeoff.rivals import FFT, MONTE_CARLO, RAYS

_LOOK = {OURS: ("C3", "o"), FFT: ("C0", "s"), MONTE_CARLO: ("C2", "^"), RAYS: ("0.5", "v")}
_PANELS = {"pixel": "largest relative error of a pixel", "ee": "largest error of an ensquared energy"}


def draw(stream: BinaryIO, title: str, measurements: Sequence[Measurement]) -> None:
    """Write the picture as PNG: pixels to the left, energies to the right.

    Errors of 0 have no place on the axis; a method that has no others is named as such. A panel in which no error is
    above 0 is left out. Raises ImportError where matplotlib is missing.
    """
    drawn = [name for name in _PANELS if any(_shown(m, name) for m in measurements)]
    with sheet(stream, 1.2 + 3.7 * len(drawn), 3.6) as figure:
        axes = figure.subplots(1, len(drawn), squeeze=False, sharex=True)[0]
        for axis, name in zip(axes, drawn, strict=True):
            for method in dict.fromkeys(m.method for m in measurements):
                _line(axis, name, [m for m in measurements if m.method == method and _shown(m, name)])
            exact = {m.method for m in measurements} - {m.method for m in measurements if _shown(m, name)}
            for method in exact:
                axis.text(0.96, 0.93, f"{method}: 0", transform=axis.transAxes, ha="right", color=_LOOK[method][0])
            axis.set(xscale="log", yscale="log", xlabel="time of one image  [s]", ylabel=_PANELS[name])
            axis.minorticks_off()
            axis.margins(0.08)
        figure.suptitle(title, fontsize=9.5)
        handles, labels = axes[-1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def _shown(m: Measurement, name: str) -> bool:
    error = getattr(m.true, name)
    return math.isfinite(error) and error > 0.0


def _line(axis: Any, name: str, points: Sequence[Measurement]) -> None:
    """One method: full marks for what was measured, a hollow one on a dotted line for what is extrapolated."""
    if not points:
        return
    colour, mark = _LOOK[points[0].method]
    measured = [(m.seconds, getattr(m.true, name)) for m in points if not m.extrapolated]
    axis.plot(*zip(*measured, strict=True), color=colour, marker=mark, label=points[0].method)
    beyond = [(m.seconds, getattr(m.true, name)) for m in points if m.extrapolated]
    if beyond:
        axis.plot(*zip(*measured[-1:], *beyond, strict=True), color=colour, ls=":", zorder=1.9)
        axis.plot(*zip(*beyond, strict=True), color=colour, marker=mark, mfc="white", ls="")
        axis.annotate(
            "extrapolated", beyond[-1], (2, -12), textcoords="offset points", ha="right", color=colour, size=7.5
        )
    for m in points:
        if m.setting in PRESETS:
            place = m.seconds, getattr(m.true, name)
            axis.annotate(m.setting, place, (-6, -3), textcoords="offset points", ha="right", color=colour, size=7.5)
