"""A sheet to draw on, and its way into a PNG file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np

_COLOURS = 96
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 4.5,
    "legend.frameon": False,
}


@contextmanager
def sheet(stream: BinaryIO, width: float, height: float, *, colours: int | None = _COLOURS) -> Iterator[Any]:
    """A matplotlib Figure of ``width`` x ``height`` inches to draw on; written to ``stream`` as PNG at the end.

    No more than ``colours`` (at most 256) are kept: such a file is a third as large. None, for what has a colour map,
    keeps all. The same drawing gives the same bytes. Raises ImportError where matplotlib is missing.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image  # matplotlib needs it, too

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        yield figure
        canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    (drawn.quantize(colours) if colours else drawn).save(stream, "png", optimize=True)
