"""Options over a system file: what they replace, how their faults are told, and the text that comes of it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from conftest import FINITE, GOOD

from psfcli.surface.psd import KCorrelation
from psfcli.tolerance import PRESETS, Tolerance


def test_options_replace_what_the_file_says(system: Any) -> None:
    overrides = [
        "surfaces.0.psd.0.sigma=1 nm",
        "surfaces.0.psd.C=2",
        "surfaces.1.psd.1.B=2 mm",
        "detector.oversample=5",
    ]
    made = system(GOOD, overrides, ["0.1 deg", "{radius: 0.2 deg, azimuth: 0 deg}"], "reference")
    assert made.surfaces[0].psd == (KCorrelation(1e-6, 1.0, 2.0),)
    assert made.surfaces[1].psd[1].B == 2.0
    assert made.detector.oversample == 5
    assert [f.azimuth for f in made.fields] == [math.pi / 2.0, 0.0]
    assert made.tolerance == PRESETS["reference"]
    assert system(GOOD, tolerance=Tolerance(1e-4, 1e-6)).tolerance == Tolerance(1e-4, 1e-6)


def test_an_option_may_add_a_section(system: Any) -> None:
    assert system(GOOD, ["ensquared_energy.half_widths=[1.05 um]"]).half_widths == (0.00105,)


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (
            (["surfaces.0.psd.C=1"],),
            "--set surfaces.0.psd.C: surfaces[0].psd.C: 1 is out of range; allowed: above 1, up to",
        ),
        (
            (["surfaces.0.psd.A=1 nm3"],),
            "--set surfaces.0.psd.A: surfaces[0].psd: exactly one of sigma, A, S0 is wanted",
        ),
        ((["detector.pixl=3 um"],), "--set detector.pixl: detector.pixl: unknown key; did you mean pixel?"),
        ((["surfaces.7.name=x"],), "--set surfaces.7.name: surfaces: 7 is no index of this list; allowed: 0..1"),
        (
            (["detector.pixel.x=1"],),
            "--set detector.pixel.x: detector.pixel: there is no x in the single value '21 um'",
        ),
        ((["detector.pixel"],), "--set detector.pixel: write it as dotted.key=value"),
        ((["title=[a"],), "--set title: not valid YAML: expected ',' or ']'"),
        ((["detector.pixel="],), "--set detector.pixel: detector.pixel: nothing where a number with a unit is wanted"),
        (
            (["telescope.aperture_diameter=1 m"],),
            "--set telescope.aperture_diameter: surfaces[0].marginal_height: '95 mm'",
        ),
        (([], ["0.3"]), '--field "0.3": fields[0]: 0.3 has no unit; write for example 0.3 deg'),
        (([], None, "best"), "--accuracy best: accuracy: 'best' is unknown; allowed: draft, standard, reference"),
        (([], None, Tolerance(0.0, 1e-3)), "--pixel-error 0.0: accuracy.pixel: 0.0 is out of range; allowed: 1e-12..1"),
    ],
)
def test_a_fault_of_an_option_begins_with_the_option(faults: Any, options: Any, fault: str) -> None:
    (line,) = faults(GOOD, *options)
    assert line.startswith(fault)


def test_all_faults_come_at_once_in_the_order_they_stand(faults: Any) -> None:
    text = GOOD.replace("1.8}\n  - marg", "0.5}\n  - marg").replace("95 mm", "90 mm").replace("schema: 1", "schema: 3")
    text = text.replace("pixels: 64", "pixls: 64").replace("obscuration: 0.48", "obscuration: none")
    lines = faults(text, ["title=[1]"])
    assert [line.split(" ")[1] for line in lines] == [
        "schema:", "telescope.obscuration:", "surfaces[0].marginal_height:", "surfaces[0].psd.C:",
        "detector.pixls:", "title:",
    ]  # fmt: skip


def test_the_text_is_the_file_itself_without_options(system: Any) -> None:
    assert system(GOOD).text == GOOD


@pytest.mark.parametrize("text", [GOOD, FINITE, GOOD.replace("title: Two mirrors", 'title: "1e-9"')])
def test_the_effective_text_loads_back_to_the_same_system(system: Any, text: str) -> None:
    made = system(text, ["surfaces.0.name=0o17 no", "surfaces.1.psd.0.C=1.5e0"], None, Tolerance(1.5e-4, 1e-6))
    again = system(made.text)
    assert again == made


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"fields": "0.3 deg"}, r"fields: '0.3 deg' is no list of texts; write for example \[\"0.3 deg\"\]"),
        ({"fields": [0.3]}, r"fields: \[0.3\] is no list of texts"),
        ({"overrides": "detector.pixels=8"}, "overrides: 'detector.pixels=8' is no list of texts"),
        ({"tolerance": (1e-3, 1e-5)}, r"tolerance: \(0.001, 1e-05\) is neither a name"),
    ],
)
def test_an_option_of_the_wrong_type_is_told(system: Any, options: Any, told: str) -> None:
    with pytest.raises(TypeError, match=told):
        system(GOOD, **options)


@pytest.mark.parametrize(
    "twin",
    [
        "{radius: 0.3 deg, azimuth: 390 deg}",
        "{radius: 0.3 deg, azimuth: -330 deg}",
        "{radius: -0.3 deg, azimuth: 210 deg}",
        "{radius: -0.3 deg, azimuth: -150 deg}",
    ],
)
def test_a_field_a_turn_further_or_mirrored_twice_is_the_same_field(faults: Any, twin: str) -> None:
    fields = GOOD.replace("[0 deg, 0.25 deg]", f"[{{radius: 0.3 deg, azimuth: 30 deg}}, {twin}]")
    (line,) = faults(fields)
    assert "fields[1]: is the same as fields[0]; each may stand once" in line


def test_the_axis_has_no_azimuth(faults: Any) -> None:
    (line,) = faults(GOOD.replace("0.25 deg]", "{radius: 0 deg, azimuth: 30 deg}]"))
    assert "fields[1]: is the same as fields[0]" in line
