"""The configurations users start from: each runs, keeps its promises, and gives the same bytes every time."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from psfcli import recipe
from psfcli.config import load
from psfcli.tolerance import PRESETS

if TYPE_CHECKING:
    from psfcli.products.arrays import Result

ROOT = Path(__file__).resolve().parent.parent
CONFIGS = {path.stem: path for path in sorted((ROOT / "configs").glob("*.yaml"))}
GOLDEN = [sys.executable, str(ROOT / "scripts" / "golden.py")]

# Both are computed on their own, each within ee; at reference 2e-8 is what is promised, elsewhere ee is seldom used up.
SUM_IS_ONE = {"draft": 1e-3, "standard": 1e-5, "reference": 2e-8}

every_config = pytest.mark.parametrize("name", CONFIGS)


@cache
def result(name: str, accuracy: str = "draft", *overrides: str) -> Result:
    return recipe.run(load(CONFIGS[name], overrides, tolerance=accuracy))


def test_there_are_configurations():
    assert len(CONFIGS) >= 6


@every_config
def test_check_passes_and_says_nothing_against_it(name):
    assert load(CONFIGS[name]).warnings == ()


@every_config
def test_every_value_is_finite_and_none_is_negative(name):
    made = result(name)
    assert made.psf_over is not None
    for values in (made.psf, made.psf_over):
        assert np.all(np.isfinite(values))
        assert np.all(values >= 0.0)
    assert all(0.0 <= summary.power_outside < 1.0 for summary in made.summaries)


@every_config
def test_every_pixel_is_lit_where_there_is_scatter(name):
    made = result(name)
    if any(row.g > 0.0 for row in made.header.surfaces):
        assert made.psf.min() > 0.0
        assert made.psf_over.min() > 0.0


@every_config
def test_sub_pixels_add_up_to_their_pixel(name):
    made = result(name)
    n, over = made.header.detector.pixels, made.header.detector.oversample
    blocks = made.psf_over.reshape(*made.psf.shape[:2], n, over, n, over).sum(axis=(3, 5))
    np.testing.assert_allclose(blocks, made.psf, rtol=1e-12, atol=0.0)


@every_config
@pytest.mark.parametrize("accuracy", PRESETS)
def test_light_outside_the_window_is_what_the_window_lacks(name, accuracy):
    # three boxes in place of the default ones: they take most of the time at reference, and are not looked at here
    few = "ensquared_energy.half_widths=[21 um, 210 um, 2.1 mm]"
    made = result(name, accuracy, few)
    inside = made.psf.sum(axis=(2, 3)).ravel()
    outside = np.array([summary.power_outside for summary in made.summaries])
    np.testing.assert_allclose(inside + outside, 1.0, rtol=0.0, atol=SUM_IS_ONE[accuracy])
    for reached in made.reached:
        assert reached.pixel <= PRESETS[accuracy].pixel
        assert reached.ee <= PRESETS[accuracy].ee


@every_config
def test_ensquared_energy_grows_with_the_box_from_0_to_1(name):
    for summary in result(name).summaries:
        boxes = summary.ensquared
        for energy in (boxes.ee, boxes.ee_chief, boxes.ee_centroid, boxes.ee_unaberrated):
            assert energy.min() >= 0.0
            assert energy.max() <= 1.0
            assert np.all(np.diff(energy) >= 0.0)


def test_a_pixel_does_not_depend_on_the_window_around_it():
    name, allowed = "euv_two_mirror", PRESETS["standard"]
    shared = ("detector.oversample=1", "fields=[0.5 deg]")
    small = result(name, "standard", "detector.pixels=64", *shared)
    large = result(name, "standard", "detector.pixels=256", *shared)
    middle = large.psf[0, 0, 96:160, 96:160]
    # what unscattered light touches, and the eight neighbours, may be off by ee besides
    unscattered = result("perfect_mirrors", "standard", "detector.pixels=64", *shared).psf[0, 0]
    touched = np.zeros((66, 66), dtype=bool)
    for dy in range(3):
        for dx in range(3):
            touched[dy : dy + 64, dx : dx + 64] |= unscattered > 0.0
    bound = allowed.pixel * middle + allowed.ee * touched[1:-1, 1:-1]
    assert np.all(np.abs(small.psf[0, 0] - middle) <= 2.0 * bound)


@every_config
def test_two_runs_and_two_jobs_give_the_same_bytes(name, tmp_path):
    system = load(CONFIGS[name], tolerance="draft")
    made = []
    for place, jobs in (("first", 1), ("second", 1), ("third", 2)):
        recipe.write(system, tmp_path / place, jobs=jobs)
        files = [path for path in (tmp_path / place).iterdir() if path.name != "manifest.json"]
        made.append({path.name: path.read_bytes() for path in files})
    assert {"psf.fits", "psf.exr", "ee.csv"} <= set(made[0])
    assert made[0] == made[1]
    assert made[0] == made[2]


def test_two_processes_give_the_same_bytes(tmp_path):
    made = []
    for seed in ("1", "2"):
        place = tmp_path / seed
        command = [sys.executable, "-m", "psfcli", "run", str(CONFIGS["three_mirror"]), "-o", str(place), "-q"]
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        subprocess.run([*command, "--accuracy", "draft"], check=True, capture_output=True, env=environment)
        made.append({path.name: path.read_bytes() for path in place.iterdir() if path.name != "manifest.json"})
    assert made[0] == made[1]


def test_the_roughness_of_the_paper_is_the_one_its_numbers_allow():
    # physics: the printed 56 % and "less than 19 %" both hold for a TIS in 0.5641..0.565 alone
    for row in result("euv_two_mirror").header.surfaces:
        assert row.tis == pytest.approx(0.5645, abs=1e-6)
        assert row.sigma_rel == pytest.approx(0.6820034e-6, rel=1e-7)
    lines = [row.tis for row in result("euv_six_lines").header.surfaces if row.name == "primary"]
    np.testing.assert_allclose(lines, [0.5645, 0.348, 0.222, 0.176, 0.087, 0.076], atol=2e-3)


def test_a_configuration_without_golden_products_fails_and_says_so(tmp_path):
    done = subprocess.run([*GOLDEN, "check", "--golden", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    for name in CONFIGS:
        assert f"{name}: FAILED" in done.stdout
        assert f"no golden psf.fits and ee.csv in {tmp_path / name}; make golden-update writes them" in done.stdout


@every_config
def test_every_configuration_has_golden_products(name):
    assert {path.name for path in (ROOT / "tests" / "golden" / name).iterdir()} == {"psf.fits", "ee.csv"}


def test_golden_products_are_small():
    assert sum(path.stat().st_size for path in (ROOT / "tests" / "golden").rglob("*")) < 1.5e6
