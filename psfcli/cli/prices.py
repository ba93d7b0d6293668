"""What each accuracy with a name costs, as ``make figures`` measured it over the example systems."""

from __future__ import annotations

import json
from pathlib import Path


def price_tags() -> str:
    """One sentence: the largest true errors of each preset, and its time as a ratio to ``standard``."""
    tags = json.loads(Path(__file__).with_name("prices.json").read_text(encoding="utf-8"))
    told = (f"{name} {tag['pixel_error']:.0e}, {tag['ee_error']:.0e}, x {tag['time']:g}" for name, tag in tags.items())
    return (
        "Measured on the example systems (largest error of a pixel, of an ensquared energy, time against standard): "
        + "; ".join(told)
        + "."
    )
