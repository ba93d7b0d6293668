from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest
from astropy.io import fits
from click.testing import CliRunner
from product_scenes import random_image, run_header, write_run

from psfcli.cli.compare import command
from psfcli.image.grid import Detector
from psfcli.products.compare import ComparisonError, compare
from psfcli.products.writer import ProductWriter
from psfcli.tolerance import Tolerance

# random_image's spot spans x -20..20 and y -10..30 um, in 32 pixels of 21 um: columns 15, 16 and rows 15..17
HEADER = run_header(fields=2, detector=Detector(0.021, 32, 1))
FAR = (1, 2, 3)
TOUCHED = (1, 17, 16)
NEIGHBOUR = (1, 18, 14)
BEYOND_NEIGHBOUR = (1, 19, 16)


@pytest.fixture
def pair(tmp_path):
    """Two equal runs, and a function that changes one value of the second's PSF."""
    write_run(tmp_path / "a", HEADER)
    shutil.copytree(tmp_path / "a", tmp_path / "b")

    def change(place, value):
        """Set the pixel in b to ``value(old)``; the old value."""
        with fits.open(tmp_path / "b" / "psf.fits", mode="update") as hdus:
            old = float(hdus["PSF"].data[place])
            hdus["PSF"].data[place] = value(old)
        return old

    return tmp_path / "a", tmp_path / "b", change


def run_command(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments])


def test_equal_products_are_within_nothing(pair):
    a, b, _ = pair
    assert compare(a, b, Tolerance(0.0, 0.0)).within
    assert all(d.absolute == 0.0 for d in compare(a, b).differences)
    assert run_command(a, b).exit_code == 0
    assert run_command(a / "psf.fits", b / "psf.fits").exit_code == 0
    assert run_command(a / "ee.csv", b / "ee.csv").exit_code == 0


@pytest.mark.parametrize(("factor", "within"), [(1.0 - 0.9e-3, True), (1.0 - 1.1e-3, False)])
def test_a_far_pixel_may_differ_by_a_fraction_of_itself(pair, factor, within):
    a, b, change = pair
    change(FAR, lambda old: old * factor)
    assert compare(a, b, Tolerance(1e-3, 1.0)).within is within
    found = {d.name: d for d in compare(a, b, Tolerance(1e-3, 1.0)).differences}["PSF 1"]
    assert found.beyond == (0 if within else 1)
    assert found.relative == pytest.approx(1.0 - factor, rel=1e-9)
    assert found.share == pytest.approx((1.0 - factor) / 1e-3, rel=1e-9)


def test_a_faint_pixel_counts_as_much_as_a_bright_one(tmp_path):
    for name, faint in (("a", 1e-25), ("b", 0.9e-25)):
        with ProductWriter(tmp_path / name, HEADER) as products:
            for field in (0, 1):
                image = random_image(HEADER, field)
                psf = image.psf.copy()
                psf[0, 0] = faint
                products.add(0, field, dataclasses.replace(image, psf=psf))
    assert compare(tmp_path / "a", tmp_path / "b", Tolerance(0.11, 0.0)).within
    result = compare(tmp_path / "a", tmp_path / "b", Tolerance(0.09, 1e-3))
    assert [(d.name, d.beyond) for d in result.differences if d.beyond] == [("PSF 1", 2)]


@pytest.mark.parametrize(("place", "within"), [(TOUCHED, True), (NEIGHBOUR, True), (BEYOND_NEIGHBOUR, False)])
def test_where_unscattered_light_falls_an_energy_error_is_allowed(pair, place, within):
    a, b, change = pair
    change(place, lambda old: old + 0.9e-5)
    assert compare(a, b, Tolerance(0.0, 1e-5)).within is within


@pytest.mark.parametrize(
    ("first", "second", "within"),
    [(0.0, 0.0, True), (0.0, 9e-31, True), (3e-31, 8e-31, True), (0.0, 2e-30, False), (1e-300, 1e-20, False)],
)
def test_below_the_floor_only_below_is_asked(tmp_path, first, second, within):
    for name, value in (("a", first), ("b", second)):
        with ProductWriter(tmp_path / name, HEADER) as products:
            for field in (0, 1):
                image = random_image(HEADER, field)
                psf = image.psf.copy()
                psf[0, 0] = value
                products.add(0, field, dataclasses.replace(image, psf=psf))
    assert compare(tmp_path / "a", tmp_path / "b", Tolerance(0.1, 0.0)).within is within


def test_a_value_that_is_not_a_number_is_beyond(pair):
    a, b, change = pair
    change(FAR, lambda _: np.nan)
    assert not compare(a, b, Tolerance(1.0, 1.0)).within


def test_unless_told_the_accuracies_asked_for_add_up(tmp_path):
    for name, asked in (("a", Tolerance(1e-3, 1e-5)), ("b", Tolerance(1e-6, 1e-8))):
        write_run(tmp_path / name, dataclasses.replace(HEADER, tolerance=asked))
    for product in (".", "psf.fits", "ee.csv"):
        allowed = compare(tmp_path / "a" / product, tmp_path / "b" / product).tolerance
        assert (allowed.pixel, allowed.ee) == (1e-3 + 1e-6, 1e-5 + 1e-8)


def test_a_lone_table_needs_to_be_told(pair, tmp_path):
    a, _, _ = pair
    lone = tmp_path / "lone" / "ee.csv"
    lone.parent.mkdir()
    shutil.copy(a / "ee.csv", lone)
    with pytest.raises(ComparisonError, match="--ee-error"):
        compare(a / "ee.csv", lone)
    assert run_command(a / "ee.csv", lone).exit_code == 2
    assert run_command(a / "ee.csv", lone, "--pixel-error", "0", "--ee-error", "0").exit_code == 0


@pytest.mark.parametrize(("step", "code"), [(0.9e-5, 0), (1.1e-5, 1)])
def test_ensquared_energy_may_differ_by_its_error(pair, step, code):
    a, b, _ = pair
    lines = (b / "ee.csv").read_text().splitlines()
    row = lines[7].split(",")
    row[5] = repr(float(row[5]) + step)
    (b / "ee.csv").write_text("\n".join([*lines[:7], ",".join(row), *lines[8:]]) + "\n")
    assert run_command(a / "ee.csv", b / "ee.csv", "--pixel-error", "1", "--ee-error", "1e-5").exit_code == code


def test_versions_timings_and_the_system_file_are_not_compared(tmp_path):
    write_run(tmp_path / "a", HEADER)
    write_run(tmp_path / "b", dataclasses.replace(HEADER, config="other: 1\n", title="Other", command="other"))
    assert compare(tmp_path / "a", tmp_path / "b", Tolerance(0.0, 0.0)).within


def test_a_different_telescope_is_found_by_its_cards(pair, tmp_path):
    a, _, _ = pair
    write_run(tmp_path / "c", dataclasses.replace(HEADER, detector=Detector(0.022, 32, 1)))
    found = [d.name for d in compare(a, tmp_path / "c").differences if d.beyond]
    assert {"PSF 1 PIXELSCL", "PSF 1 CDELT1A", "EE width_px"} <= set(found)


def test_what_has_another_shape_cannot_be_compared(pair, tmp_path):
    a, _, _ = pair
    others = {
        "pixels": dataclasses.replace(HEADER, detector=Detector(0.021, 31, 1)),
        "oversample": dataclasses.replace(HEADER, detector=Detector(0.021, 32, 3)),
        "fields": dataclasses.replace(HEADER, fields=HEADER.fields[:1]),
    }
    for name, header in others.items():
        write_run(tmp_path / name, header)
        for product in (".", "psf.fits"):
            with pytest.raises(ComparisonError):
                compare(a / product, tmp_path / name / product)
    assert run_command(a / "ee.csv", tmp_path / "fields" / "ee.csv").exit_code == 2


def test_what_cannot_be_read_cannot_be_compared(pair, tmp_path):
    a, b, _ = pair
    whole = (b / "psf.fits").read_bytes()
    for broken in (b"", b"text", whole[: len(whole) // 2], whole[:2880]):
        (b / "psf.fits").write_bytes(broken)
        result = run_command(a, b)
        assert result.exit_code == 2
        assert result.stderr.count("\n") == 1
    (b / "ee.csv").write_text("wavelength\n9.4\n")
    (tmp_path / "empty").mkdir()
    for first, second in ((a, a / "psf.fits"), (a / "psf.fits", a / "ee.csv"), (a, tmp_path / "empty"), (a, "none")):
        assert run_command(first, second).exit_code == 2
    assert run_command(a / "ee.csv", b / "ee.csv").exit_code == 2
    assert run_command(a, a, "--ee-error", "1e-5").exit_code == 2
    assert run_command(a, a, "--pixel-error", "nan", "--ee-error", "nan").exit_code == 2


def test_a_report_names_what_differs(pair):
    a, b, change = pair
    change(FAR, lambda old: 1.1 * old)
    result = run_command(a, b)
    assert result.exit_code == 1
    assert "PSF 1" in result.stdout
    assert "1 of 2048" in result.stdout
    assert "beyond what is allowed: pixel error 0.002" in result.stdout
