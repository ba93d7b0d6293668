"""The picture of README.md: a two-mirror EUV telescope on the axis and at the edge of its field.

Usage: python scripts/picture.py [OUTPUT.png]      (default docs/euv_two_mirror.png; needs matplotlib)

Runs configs/euv_two_mirror.yaml in this process, at its own accuracy, and draws the result: the image of a point at two
field angles, and the ensquared energy with and without aberrations.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import psfcli
from psfcli.pictures.canvas import sheet
from psfcli.pictures.energy import EnergyCurve, energy_panel
from psfcli.pictures.psf import colour_bar, decades, density, psf_panel

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "configs" / "euv_two_mirror.yaml"
PICTURE = ROOT / "docs" / "euv_two_mirror.png"

HALF_WIDTHS = np.geomspace(0.2, 2e4, 151)  # um
OVERRIDES = (
    "detector.pixels=8",
    "detector.oversample=40",  # sub-pixels of 0.525 um: finer than what the spots show
    "ensquared_energy={half_widths: [" + ", ".join(f"{half_width:.6g} um" for half_width in HALF_WIDTHS) + "]}",
)
FIELDS = ("0 deg", "0.5 deg")


def draw(path: Path) -> None:
    """Compute the two fields and write the picture."""
    system = psfcli.load(CONFIG, overrides=OVERRIDES, fields=FIELDS)
    result = psfcli.run(system)
    edges, pixel = 1e3 * system.detector.edges(0), 1e3 * system.detector.pixel  # um
    names = [field.replace(" deg", "°") for field in FIELDS]
    images = result.psf_over[0]
    limits = decades(density(image, edges, edges) for image in images)
    rows = result.ensquared_energy.group_by("field").groups
    curves = [
        EnergyCurve(name, each["half_width_um"].value, np.asarray(each["ee"]))
        for name, each in zip(names, rows, strict=True)
    ]
    smooth = EnergyCurve("no aberrations", curves[0].half_width, np.asarray(rows[0]["ee_unaberrated"]))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream, sheet(stream, 11.0, 3.4, colours=None) as figure:
        axes = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.3))
        drawn: list[Any] = []
        for panel, image, name, letter in zip(axes[:2], images, names, "ab", strict=True):
            drawn.append(psf_panel(panel, image, edges, edges, limits, pixel))
            panel.set_title(f"({letter})  field {name}", loc="left")
        axes[1].set_ylabel("")
        colour_bar(figure, drawn)
        energy_panel(axes[2], curves, smooth, pixel)
        axes[2].legend(loc="lower right")
        figure.get_layout_engine().set(wspace=0.05)
        axes[2].set_title("(c)  ensquared energy", loc="left")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
