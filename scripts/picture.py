"""The picture of README.md: a two-mirror EUV telescope on the axis and at the edge of its field.

Usage: python scripts/picture.py [OUTPUT.png]      (default docs/euv_two_mirror.png; needs matplotlib)

Runs configs/euv_two_mirror.yaml in this process, at its own accuracy, and draws the result: the image of a point at two
field angles, and the ensquared energy with and without aberrations.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

import psfcli

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "configs" / "euv_two_mirror.yaml"
PICTURE = ROOT / "docs" / "euv_two_mirror.png"

PIXELS = 8
HALF_WIDTHS = np.geomspace(0.2, 2e4, 151)  # um
OVERRIDES = (
    f"detector.pixels={PIXELS}",
    "detector.oversample=40",  # sub-pixels of 0.525 um: finer than what the spots show
    "ensquared_energy={half_widths: [" + ", ".join(f"{half_width:.6g} um" for half_width in HALF_WIDTHS) + "]}",
)
FIELDS = ("0 deg", "0.5 deg")
LEAST, MOST = 1.0, 1e4  # irradiance shown [1/mm^2]

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.linewidth": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.frameon": False,
}


def draw(path: Path) -> None:
    """Compute the two fields and write the picture."""
    system = psfcli.load(CONFIG, overrides=OVERRIDES, fields=FIELDS)
    result = psfcli.run(system)
    plt.rcParams.update(STYLE)
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.0), width_ratios=(1.0, 1.0, 1.3), layout="constrained")
    figure.get_layout_engine().set(wspace=0.06)
    drawn = None
    for index, (panel, letter) in enumerate(zip(axes[:2], "ab", strict=True)):
        drawn = image(panel, result.psf_over[0, index], system.detector)
        panel.set_title(f"({letter})  field {FIELDS[index].replace(' deg', '°')}", loc="left")
    axes[0].set_ylabel("y  [µm]")
    axes[1].tick_params(labelleft=False)
    bar = figure.colorbar(drawn, ax=axes[:2], extend="both", pad=0.015, aspect=24)
    bar.set_label("fraction of all light per mm²")
    bar.ax.tick_params(direction="out")
    energies(axes[2], result.ensquared_energy)
    axes[2].set_title("(c)  ensquared energy", loc="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=140, metadata={"Software": None})


def image(panel: plt.Axes, fraction: np.ndarray, detector: object) -> object:
    """Draw the fractions per sub-pixel as irradiance about the Gaussian image point."""
    half_window = 0.5e3 * detector.pixels * detector.pixel
    ticks = 1e3 * detector.pixel * np.arange(-PIXELS // 2, PIXELS // 2 + 1)
    drawn = panel.imshow(
        fraction / detector.sub_pixel**2,
        norm=LogNorm(LEAST, MOST),
        cmap="inferno",
        origin="lower",
        extent=(-half_window, half_window, -half_window, half_window),
        interpolation="bilinear",
    )
    panel.set(xlabel="x  [µm]", xticks=ticks[1:-1], yticks=ticks[1:-1])
    for edge in ticks[1:-1]:  # the detector's pixels
        panel.axvline(edge, color="white", lw=0.3, alpha=0.35)
        panel.axhline(edge, color="white", lw=0.3, alpha=0.35)
    return drawn


def energies(panel: plt.Axes, table: object) -> None:
    """Draw the ensquared energy of each field, and that of the telescope without aberrations."""
    first = table["field"] == table["field"].min()
    panel.semilogx(
        table["half_width_um"][first].value,
        table["ee_unaberrated"][first],
        color="0.45",
        ls=":",
        label="no aberrations",
    )
    for field, look in zip(np.unique(table["field"].value), ("C0-", "C3--"), strict=True):
        rows = table["field"].value == field
        panel.semilogx(table["half_width_um"][rows].value, table["ee"][rows], look, label=f"{field:g}°")
    panel.set(
        xlabel="half width about the Gaussian image point  [µm]",
        ylabel="fraction of all light",
        xlim=(0.2, 2e4),
        ylim=(0.0, 1.0),
    )
    panel.axvline(10.5, color="0.75", lw=0.6, zorder=0)
    panel.text(11.5, 0.03, "1 pixel", color="0.4", fontsize=7)
    panel.grid(color="0.9", lw=0.4)
    panel.legend(loc="upper left")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
