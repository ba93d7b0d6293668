"""System files that are good: what they mean, in the units used inside."""

from __future__ import annotations

import math
from typing import Any

import pytest
from conftest import FINITE, GOOD

from psfcli.config.tree import atom
from psfcli.config.units import FREQUENCY, LENGTH, convert
from psfcli.surface.psd import KCorrelation
from psfcli.telescope.system import Field
from psfcli.tolerance import PRESETS


def test_a_system_holds_mm_and_radians(system: Any) -> None:
    made = system(GOOD)
    assert made.wavelengths == (9.4e-6,)
    assert made.telescope.focal_length == 1750.0
    assert made.telescope.image_slope == 190.0 / 3500.0
    assert made.telescope.max_field == pytest.approx(math.radians(0.5), rel=1e-15)
    assert pytest.approx(-30.35 * 9.4e-6, rel=1e-15) == made.telescope.seidel.W020
    assert made.telescope.pupil.is_full_annulus
    assert [s.marginal_height for s in made.surfaces] == [95.0, -34.99]
    assert [s.name for s in made.surfaces] == ["primary", "surface_2"]
    assert made.surfaces[0].psd == (KCorrelation(0.682e-6, 1.0, 1.8),)
    assert made.surfaces[1].psd[1] == KCorrelation.from_S0(1e-24, 1.0, 2.0)
    assert made.detector.pixel == 0.021
    assert made.tolerance == PRESETS["draft"]
    assert made.half_widths is None
    assert made.warnings == ()


def test_finite_conjugates_have_heights_for_fields(system: Any) -> None:
    made = system(FINITE)
    assert not made.telescope.object_at_infinity
    assert made.telescope.image_slope == 50.0 / 2000.0
    assert made.telescope.max_field == 5.0
    assert made.fields == (Field(0.0), Field(-2.5))


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-9", 1e-9), ("010", 10), ("0o17", 15), ("0x1F", 31), ("1.0E+5", 1e5), (".5", 0.5), ("-3", -3), ("true", True)],
)
def test_numbers_are_read_as_yaml_1_2_reads_them(text: str, value: float) -> None:
    assert atom(text) == value
    assert type(atom(text)) is type(value)


@pytest.mark.parametrize("text", ["no", "on", "yes", "1:30", "1_000", "2001-01-00", "0b11", "1e", "+", "\u0661"])
def test_other_words_stay_words(text: str) -> None:
    assert atom(text) == text


@pytest.mark.parametrize(
    "text", ["0.00105 mm", "1.05 um", "1050nm", "1.05 micron", "1.05 µm", "10500 AA", "1.05e-3 mm"]
)
def test_a_length_is_the_same_in_every_unit(text: str) -> None:
    # units that astropy alone knows carry its factor's rounding
    assert convert(text, LENGTH, "um") == pytest.approx(0.00105, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["2 1/mm", "2 cycle/mm", "2 cycles/mm", "2 lp/mm", "2/mm", "2000 1/m", "0.002 cycles/um", "2 mm-1"]
)
def test_a_spatial_frequency_has_no_two_pi(text: str) -> None:
    assert convert(text, FREQUENCY, "cycles/mm") == pytest.approx(2.0, rel=1e-15)


def test_a_bare_number_is_told_which_unit_to_write(faults: Any) -> None:
    assert faults(GOOD.replace("21 um", "21")) == ["20:19: detector.pixel: 21 has no unit; write for example 21 um"]


def spectrum(system: Any, psd: str) -> KCorrelation:
    """The one term of the first surface with the given ``psd``."""
    made = system(GOOD.replace("{sigma: 0.682 nm, B: 1 mm, C: 1.8}\n  - marg", f"{psd}\n  - marg"))
    (term,) = made.surfaces[0].psd
    return term


def test_every_convention_can_say_the_same_spectrum(system: Any) -> None:
    B, C, sigma = 1.0, 1.8, 0.682e-6
    S0 = sigma**2 * (C - 1.0) * B**2 / (2.0 * math.pi)
    A = S0 / B * 2.0 * math.sqrt(math.pi) * math.gamma(C / 2.0) / math.gamma((C + 1.0) / 2.0)
    full = KCorrelation(sigma, B, C)
    band = math.sqrt(full.band_variance(0.01, 5.0))
    below = math.sqrt(full.band_variance(0.0, 1.0 / 632.8e-6))
    said = [
        "{sigma: 0.682 nm, B: 1 mm, C: 1.8}",
        f"{{S0: {S0!r} mm4, B: 1 mm, C: 1.8}}",
        f"{{A: {A!r} mm^3, B: 1 mm, C: 1.8, convention: harvey}}",
        f"{{sigma: {band!r} mm, sigma_band: [10 1/m, 5 lp/mm], B: 1 mm, C: 1.8}}",
        f"{{convention: scatmech, A: {S0!r} mm4, B: 1 mm, C: 2.8}}",
        f"{{convention: zemax, sigma: {below!r} mm, sigma_wavelength: 632.8 nm, B: 1 mm, s: 2.8}}",
    ]
    for psd in said:
        term = spectrum(system, psd)
        # C = s - 1 is not exact in binary, and the spectra follow it
        assert (term.sigma, term.B, term.C) == pytest.approx((sigma, B, C), rel=1e-13), psd


def test_the_zemax_example_gives_its_published_roughness(system: Any) -> None:
    term = spectrum(system, "{convention: zemax, sigma: 3 nm, sigma_wavelength: 632.8 nm, B: 5.02655 um, s: 3}")
    # the figures of physics: six digits are given
    assert math.sqrt(term.band_variance(0.0, 1.0 / 300e-6)) == pytest.approx(3.10996e-6, rel=2e-6)


def test_a_smooth_surface_has_no_terms(system: Any) -> None:
    text = GOOD.replace("    psd: {sigma: 0.682 nm, B: 1 mm, C: 1.8}\n", "").replace("S0: 1 nm4", "S0: 0 nm4")
    made = system(text)
    assert made.surfaces[0].psd == ()
    assert len(made.surfaces[1].psd) == 1


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ("0.25 deg", [(0.25, 90.0)]),
        ("[-0.1 deg, 6 arcmin]", [(-0.1, 90.0), (0.1, 90.0)]),
        ("{start: 0 deg, stop: 0.5 deg, count: 3}", [(0.0, 90.0), (0.25, 90.0), (0.5, 90.0)]),
        ("[{radius: 0.3 deg, azimuth: 30 deg}, {radius: 0.3 deg}]", [(0.3, 30.0), (0.3, 90.0)]),
    ],
)
def test_fields_come_in_four_forms(system: Any, fields: str, expected: list[tuple[float, float]]) -> None:
    made = system(GOOD.replace("[0 deg, 0.25 deg]", fields)).fields
    assert [(f.radius, f.azimuth) for f in made] == [
        pytest.approx([math.radians(a) for a in point], rel=1e-15) for point in expected
    ]


def test_azimuth_runs_from_x_towards_y(system: Any) -> None:
    made = system(GOOD.replace("[0 deg, 0.25 deg]", "[{radius: 0.5 deg, azimuth: 30 deg}]"))
    hx, hy = made.telescope.relative_field(made.fields[0])
    assert (hx, hy) == pytest.approx((math.sqrt(0.75), 0.5), rel=1e-14)


def test_a_field_beyond_the_table_is_a_warning(system: Any) -> None:
    (warning,) = system(GOOD.replace("0.25 deg]", "0.6 deg]")).warnings
    assert warning == "fields: 1 of 2 lie beyond max_field, where the Seidel table is extrapolated"


def test_surface_tables_are_summed_in_their_own_waves(system: Any) -> None:
    text = GOOD.replace("W020: -30.35, W040: 0.42", "W020: -30.35").replace(
        "  - marginal_height: -",
        "    seidel: {W040: 1}\n  - seidel: {reference_wavelength: 1 um, W040: 2}\n    marginal_height: -",
    )
    made = system(text)
    assert pytest.approx(9.4e-6 + 2e-3, rel=1e-15) == made.telescope.seidel.W040
    assert made.warnings == ()


def test_a_mirror_inherits_the_medium_it_sits_in(system: Any) -> None:
    first = "    kind: refracting\n    index: [1, 1.5]\n  - marginal_height: -"
    made = system(FINITE.replace("  - marginal_height: -", first))
    assert [(s.index_before, s.index_after) for s in made.surfaces] == [(1.0, 1.5), (1.5, 1.5)]
    assert made.telescope.image_slope == 1.5 * 50.0 / 2000.0


def test_an_offset_may_be_in_pixels(system: Any) -> None:
    made = system(GOOD.replace("pixels: 64", "pixels: 64, centre: pixel, offset: [0.5 pix, -3 um]"))
    assert made.detector.offset == (0.0105, -0.003)
    assert made.detector.centre == "pixel"


def test_aliases_and_merge_keys_repeat_a_mirror(system: Any) -> None:
    text = GOOD.replace("psd: {sigma: 0.682 nm,", "psd: &polish {sigma: 0.682 nm,", 1)
    text = text.replace("- {S0: 1 nm4, B: 1 mm, C: 2}", "- {<<: *polish, C: 2}")
    made = system(text, ["surfaces.0.psd.sigma=1 nm"])
    assert made.surfaces[0].psd[0].sigma == 1e-6
    assert made.surfaces[1].psd[1] == KCorrelation(0.682e-6, 1.0, 2.0)
