"""System files that are good, and what the tests of the system file share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from psfcli.config import ConfigError, System, load

if TYPE_CHECKING:
    from pathlib import Path

GOOD = """# A telescope
schema: 1
title: Two mirrors
wavelengths: [9.4 nm]
telescope:
  focal_length: 1750 mm
  aperture_diameter: 190 mm
  obscuration: 0.48
  max_field: 0.5 deg
  seidel: {reference_wavelength: 9.4 nm, W020: -30.35, W040: 0.42}
surfaces:
  - name: primary
    marginal_height: 95 mm
    psd: {sigma: 0.682 nm, B: 1 mm, C: 1.8}
  - marginal_height: -34.99 mm
    psd:
      - {sigma: 0.682 nm, B: 1 mm, C: 1.8}
      - {S0: 1 nm4, B: 1 mm, C: 2}
fields: [0 deg, 0.25 deg]
detector: {pixel: 21 um, pixels: 64}
accuracy: draft
"""
INFINITY = "  focal_length: 1750 mm\n  aperture_diameter: 190 mm\n"
FINITE = (
    GOOD.replace(INFINITY, "  image_distance: 2 m\n  exit_pupil_radius: 50 mm\n")
    .replace("max_field: 0.5 deg", "max_field: 5 mm")
    .replace("[0 deg, 0.25 deg]", "[0 mm, -2.5 mm]")
)
PRESCRIBED = (
    GOOD.replace("  focal_length: 1750 mm\n", "")
    .replace("  seidel: {reference_wavelength: 9.4 nm, W020: -30.35, W040: 0.42}\n", "")
    .replace("    marginal_height: 95 mm\n", "")
    .replace("  - marginal_height: -34.99 mm\n", "  - name: secondary\n")
    .replace(
        "surfaces:\n",
        "prescription:\n"
        "  stop: primary\n"
        "  image_shift: -0.2 mm\n"
        "  surfaces:\n"
        "    - {name: primary, radius: -1466.02 mm, conic: -1.18005, thickness: -463.03 mm}\n"
        "    - {name: secondary, radius: -929.14 mm, aspheric: {A4: 1e-9 1/mm^3}, thickness: focus}\n"
        "surfaces:\n",
    )
)
GOODS = [GOOD, FINITE, PRESCRIBED, GOOD.replace("[0 deg, 0.25 deg]", "{start: 0 deg, stop: 0.5 deg, count: 3}")]


@pytest.fixture
def system(tmp_path: Path) -> Any:
    """A function from a text (and options) to its system."""

    def of(text: str, *options: Any, **named: Any) -> System:
        path = tmp_path / "x.yaml"
        path.write_text(text, encoding="utf-8")
        return load(path, *options, **named)

    return of


@pytest.fixture
def faults(system: Any, tmp_path: Path) -> Any:
    """A function from a text (and options) to its faults, without the file's name."""

    def of(text: str, *options: Any, **named: Any) -> list[str]:
        with pytest.raises(ConfigError) as caught:
            system(text, *options, **named)
        return [line.removeprefix(f"{tmp_path}/x.yaml:") for line in caught.value.faults]

    return of
